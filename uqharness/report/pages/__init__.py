"""One module for each kind of report.html."""
