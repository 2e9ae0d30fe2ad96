"""The second generation's examination of refine: three draws, each met once by committed code
(docs/hidden-effects.md).
"""
