//! Which machine this is, as far as kernel locks are concerned: processes with the same [`Host::boot`] run on the same kernel, so
//! they see each other's kernel locks on a file system that they have mounted together.

use std::sync::OnceLock;

/// This machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Host {
    /// Its name, for people: not unique.
    pub name: String,
    /// Unique to this boot of this machine, where the system has such a number; else the name.
    pub boot: String,
}

/// This machine.
pub(super) fn this() -> &'static Host {
    static THIS: OnceLock<Host> = OnceLock::new();
    THIS.get_or_init(|| {
        #[cfg(debug_assertions)]
        if let Some(name) = super::fault::host() {
            return Host { name: name.clone(), boot: name };
        }
        let name = rustix::system::uname().nodename().to_string_lossy().replace(char::is_whitespace, "-");
        let boot = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
        let boot = boot.trim();
        let boot = if boot.is_empty() { name.clone() } else { boot.replace(char::is_whitespace, "-") };
        Host { name, boot }
    })
}
