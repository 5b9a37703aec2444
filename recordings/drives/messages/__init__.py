"""Messages of one picture in three dialects, and the schemas that describe them."""
