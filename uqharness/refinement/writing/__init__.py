"""Effects written into an aircraft's XML."""
