"""Whether this installation computes what it should: independent oracles, exact solutions, ``spinestiff check``."""
