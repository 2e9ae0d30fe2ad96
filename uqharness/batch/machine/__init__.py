"""Machine code of the intermediate form, by LLVM."""
