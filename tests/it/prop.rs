//! Laws over random pipelines.
