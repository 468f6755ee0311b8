//! Tables and statistics from the scores that stages wrote.
