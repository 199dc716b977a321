"""A law as self-contained C99.

Reading order: `numbers` (constants with their names), `source` (instructions as C), `text` (the files around them) ->
`export`.
"""

__all__: list[str] = []
