"""Files and texts of any kind: how they are opened, parsed, written and shown."""
