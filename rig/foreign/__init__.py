"""Other people's data: a manifest, tables, and what looks wrong with them."""
