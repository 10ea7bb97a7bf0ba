"""Sensors' own packets, from captures and from bags, to points."""
