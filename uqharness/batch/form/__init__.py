"""The intermediate form: typed values without control flow, functions of them, programs, and passes
over both.
"""
