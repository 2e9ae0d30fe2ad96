"""How a campaign's flights are spread: processes, Dask."""
