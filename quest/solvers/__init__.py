"""QuEst 5 to N and what the solvers stand on: monomials, translation and depths, Newton steps, selection of candidates."""
