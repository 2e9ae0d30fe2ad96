"""What is wrong with a log: channels by themselves, and channels against one another by physics.

Pure numerics.
"""
