"""From records to parts: one reader for each kind of experiment."""
