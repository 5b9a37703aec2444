"""The folder that a run writes: its tables, and how they are read again."""
