"""Where a model fails, which effect is missing, and what to measure next."""
