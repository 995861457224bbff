"""The normal equations: rows by autodiff, elimination of the points, reduced equations, cofactors."""
