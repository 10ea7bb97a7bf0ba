"""What a graph leaves free, by name."""
