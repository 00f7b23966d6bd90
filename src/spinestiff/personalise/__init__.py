"""The subject's own geometry from rest radiographs (paper 3.1), by energy minimisation with the mechanical engine."""
