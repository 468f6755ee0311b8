//! Fuzzes the reader `memo`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Ok(registry) = dril_stage_api::Registry::new(Vec::new()) {
        dril_pipe::cli::untrusted::memo(bytes, &registry);
    }
});
