//! What is cached, and what a change reruns.
