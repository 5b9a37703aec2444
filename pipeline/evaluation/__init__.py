"""How a result compares with the truth of its drive, or with labels."""
