"""Messages of one image in three dialects, and the schemas that describe them."""
