"""What flights and replays cost, measured on this machine; ``make bench`` runs them."""
