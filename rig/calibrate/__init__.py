"""Values, budgets and verdicts of a unit."""
