"""A model fitted to parts, and whether it leaves nothing but noise."""
