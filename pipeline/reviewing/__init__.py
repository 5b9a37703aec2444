"""What a person says of the rows of a result: corrections beside what was measured."""
