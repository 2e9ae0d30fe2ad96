"""A campaign's folder: journal, manifest, tables, digests; verified, salvaged, merged."""
