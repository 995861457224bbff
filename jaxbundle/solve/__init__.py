"""The adjustment: search, stopping rules, solver, answer."""
