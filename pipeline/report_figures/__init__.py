"""The figures of the report KS-09-9 on a user's drive, with each number next to the report's."""
