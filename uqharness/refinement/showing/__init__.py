"""What a refinement did, on flights that it did not use."""
