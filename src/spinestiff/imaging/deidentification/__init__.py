"""Radiographs without their patients (docs/deidentify.md)."""
