"""QuEst 5 to N, and their parts: monomials, translation and depths, Newton steps, selection of candidates."""
