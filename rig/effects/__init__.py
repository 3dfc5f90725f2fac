"""The shelf: one physical effect per file, found by its name (see `rig.shelf`)."""
