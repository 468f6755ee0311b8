//! Pipeline files as text: what is read, and what is refused.
