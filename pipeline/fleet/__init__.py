"""Many logs, one inventory, with its history."""
