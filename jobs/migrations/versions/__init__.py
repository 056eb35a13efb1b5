"""Migration scripts, one file per schema change."""
