"""One function for each command: a request in, files and an outcome out."""
