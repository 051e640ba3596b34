"""Reserved for the joint estimate of all views in the window (hypotheses, joint fit, risk). Empty today."""
