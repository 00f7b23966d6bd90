"""Which push to take next (docs/plan.md)."""
