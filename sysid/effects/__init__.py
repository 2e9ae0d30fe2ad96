"""Missing effects: the catalogue of candidates, their scores against flights, and the choice among them."""
