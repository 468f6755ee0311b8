//! Two users of one group who share a cache, for tests that run as root on a machine with `setpriv`.

use std::os::unix::fs::{PermissionsExt, chown};
use std::path::PathBuf;
use std::process::{Command, Stdio};

use crate::sealed::{Ended, Sealed, ended, program};

/// The users; each has a folder of that name with the pipeline `p.yaml`.
pub const USERS: [u32; 2] = [1001, 1002];
const GROUP: u32 = 3000;

/// A folder with the users' folders, and `group/`, in which both may write.
pub struct Group {
    folder: Sealed,
    program: PathBuf,
}

impl Group {
    /// None where other users cannot be played: the test is not root, or there is no `setpriv`.
    pub fn with(pipeline: &str) -> Option<Self> {
        if !rustix::process::geteuid().is_root() || Command::new("setpriv").arg("--version").output().is_err()
        {
            return None;
        }
        let folder = Sealed::new();
        let copy = folder.path("program");
        std::fs::copy(program(), &copy).unwrap();
        let allow = |name: &str, mode| {
            std::fs::set_permissions(folder.path(name), PermissionsExt::from_mode(mode)).unwrap();
        };
        allow(".", 0o755);
        std::fs::create_dir(folder.path("group")).unwrap();
        chown(folder.path("group"), None, Some(GROUP)).unwrap();
        allow("group", 0o2775);
        for user in USERS {
            folder.write(&format!("{user}/p.yaml"), pipeline);
            chown(folder.path(&user.to_string()), Some(user), Some(GROUP)).unwrap();
        }
        Some(Self { folder, program: copy })
    }

    /// The path of the shared cache.
    pub fn cache(&self) -> PathBuf {
        self.folder.path("group/cache")
    }

    /// Runs the program as `user` with `umask`, in the user's folder, on the shared cache.
    pub fn run(&self, user: u32, umask: &str, args: &str) -> Ended {
        let text = format!(
            "umask {umask}; exec setpriv --reuid={user} --regid={GROUP} --clear-groups {} {args} --cache ../group/cache",
            self.program.display()
        );
        let mut command = Command::new("sh");
        command.args(["-c", &text]).current_dir(self.folder.path(&user.to_string())).stdin(Stdio::null());
        ended(command)
    }
}
