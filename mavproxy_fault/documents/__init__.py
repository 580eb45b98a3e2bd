"""Configuration files: YAML decoded into checked structs, with the line of every error.

`ConfigError` is the only error that a user can cause. A *document* is the data of a YAML text with
the line of each key; it is *decoded* into msgspec structs. A *path* addresses a part of a document
by keys and indices from its root.
"""
