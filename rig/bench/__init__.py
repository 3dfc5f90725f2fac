"""The bench: roles, steps, the clock and operator it runs by, and the guard that leaves it at rest."""
