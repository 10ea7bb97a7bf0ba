"""The factor-graph engine."""
