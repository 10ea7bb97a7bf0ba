"""What the data say about themselves: topics, times, units, mounting; each with its evidence."""
