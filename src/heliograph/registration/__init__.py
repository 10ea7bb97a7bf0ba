"""Heliograph: registration."""
