"""What travels between stages and what is written: types, tables, settings, models."""
