"""The figures of the report KS-09-9, made again on a drive of the user's, with each number next to the report's."""
