//! In which order stages run, and what a failure stops.
