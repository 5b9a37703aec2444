"""Labels and boxes that others made, in their formats, and which box shows what."""
