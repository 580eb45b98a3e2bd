"""Files that people write: YAML in, checked structs out, every error with its line.

`ConfigError` is the one error a user can cause. A *document* is the data of a YAML text with the
line of each key; it is *decoded* into msgspec structs. A *path* leads from a document's root to a
part of it, by keys and indices.
"""
