from .tables import read_small_table as read_small_table
