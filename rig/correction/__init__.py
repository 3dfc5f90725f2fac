"""From raw volts back to acceleration and rate: how effects are undone, as plain numbers that any language can run."""
