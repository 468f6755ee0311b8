//! The command line from the outside: what people and scripts see.
