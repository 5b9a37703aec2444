"""Many logs to one inventory: where they lie, who runs them, how far they are, and questions about the result."""
