"""Which test points narrow the answer most, and the script that flies them."""
