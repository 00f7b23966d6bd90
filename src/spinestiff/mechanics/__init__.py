"""How the torso deforms (paper section 3): energies, static equilibrium and its derivatives."""
