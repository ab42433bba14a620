"""Tasks: demonstrations, partners and what counts as success."""
