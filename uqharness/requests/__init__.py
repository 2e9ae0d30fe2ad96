"""One definition of each request: command line, settings file and Python function."""
