"""The engine inside other frameworks' automatic differentiation. Each module needs its framework installed."""
