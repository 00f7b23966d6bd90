"""Synthetic radiographs: what a torso absorbs, and how a tube, a detector and a person make a sequence of it."""
