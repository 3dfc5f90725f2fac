"""What a model is compared with in foreign data: one file for each kind, by its name in a manifest, with `read`."""
