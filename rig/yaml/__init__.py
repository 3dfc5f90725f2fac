"""What a person wrote in YAML, and what is wrong with it, with its place."""
