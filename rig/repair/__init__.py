"""A model and its history, step by step."""
