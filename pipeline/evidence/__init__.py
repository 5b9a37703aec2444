"""Evidence sheets: the measurements behind a reported sign, for a person to check."""
