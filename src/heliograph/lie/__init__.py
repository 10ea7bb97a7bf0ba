"""Heliograph: lie."""
