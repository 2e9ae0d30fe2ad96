"""Translation of an aircraft's XML to programs."""
