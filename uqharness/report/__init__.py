"""Results told: words, tables, pages, charts."""
