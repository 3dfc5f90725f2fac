"""Estimates and how far to trust them: the uncertainty budget, the verdict, and what builds on them."""
