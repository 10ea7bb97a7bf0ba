"""Heliograph: cloud."""
