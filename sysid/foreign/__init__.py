"""Files that anybody may have written: opened, limited in time and memory, read as data and never
as code.
"""
