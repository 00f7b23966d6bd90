"""Synthetic subjects: what kind to make, and the whole folder with radiographs, corners and the truth."""
