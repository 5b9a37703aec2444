"""Evidence sheets: what a reported sign rests on, as pictures that a person can judge."""
