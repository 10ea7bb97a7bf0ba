"""What a problem is made of: variables in families, factors between them, and the noise they are weighed with."""
