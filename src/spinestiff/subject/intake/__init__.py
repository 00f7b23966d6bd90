"""A subject folder from what a hospital exports (docs/from-hospital.md)."""
