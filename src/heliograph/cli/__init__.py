"""Heliograph: cli."""
