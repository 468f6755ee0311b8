// The C++ compiler comes here only when it finds no libtorch: `.cargo/config.toml` puts this folder at the end of its
// search path, so that a build without libtorch ends with a remedy. A missing file stops the compiler at once, whereas
// after an `#error` it would go on through a hundred thousand more.
#include "there is no libtorch in this clone: run `cargo xtask libtorch` once (it downloads 540 MB), then build again"
