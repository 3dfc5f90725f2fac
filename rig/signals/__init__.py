"""Numbers in, numbers out: estimators that know no run and no bench."""
