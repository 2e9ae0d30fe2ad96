"""One definition of each result: what is printed, stored, read again and described by a schema."""
