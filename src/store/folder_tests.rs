//! Folders as artifacts: what is kept, what is refused, and the format that stays.

use std::os::unix::fs::PermissionsExt;

use proptest::prelude::*;

use super::*;

fn file(path: &str, text: &str) -> FolderEntry {
    let file =
        FolderFile { digest: Digest::of(text.as_bytes()), bytes: text.len() as u64, executable: false };
    FolderEntry { path: path.into(), file: Some(file) }
}

fn store() -> (tempfile::TempDir, Store) {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(&folder.path().join("store")).unwrap();
    (folder, store)
}

#[test]
fn the_list_of_a_folder_stays_the_same_for_ever() {
    let mut tool = file("bin/tool", "#!");
    tool.file.as_mut().unwrap().executable = true;
    let empty = FolderEntry { path: "logs".into(), file: None };
    let odd =
        FolderEntry { path: PathBuf::from(OsString::from_vec(b"a b\n%\xff".to_vec())), ..file("", "x") };
    let folder = Folder::new(vec![empty, tool, odd, file("data/a.csv", "1,2\n")]);
    let text = String::from_utf8(folder.to_bytes()).unwrap();
    let lines: Vec<&str> =
        text.lines().map(|line| line.trim_start_matches(|c: char| c.is_ascii_hexdigit())).collect();
    let expected = ["dril-folder 1", " 1 - a%20b%0a%25%ff", " 2 x bin/tool", " 4 - data/a.csv", "- 0 d logs"];
    assert_eq!(lines[1..], expected[1..]);
    assert_eq!(folder.digest().hex(), GOLDEN);
    assert_eq!(Folder::parse(&folder.to_bytes()), Ok(folder));
}
const GOLDEN: &str = "cc14ae353ab271ada977bd8371d90a9986e192c68ceacc53c62b56db10010cfc";

#[test]
fn a_folder_comes_back_as_it_was() {
    let (place, store) = store();
    let made = place.path().join("made");
    std::fs::create_dir_all(made.join("deep/er")).unwrap();
    std::fs::create_dir(made.join("empty")).unwrap();
    std::fs::write(made.join("deep/er/a b"), "one").unwrap();
    std::fs::write(made.join("run"), "#!/bin/sh\n").unwrap();
    std::fs::set_permissions(made.join("run"), std::fs::Permissions::from_mode(0o755)).unwrap();
    let before = fsx::walk(&made, Links::Refuse).unwrap();
    let blob = store.take_folder(&made).unwrap();
    blob.sync().unwrap();
    let laid = place.path().join("laid");
    store.lay_out(&blob.digest, &laid).unwrap();
    let after = fsx::walk(&laid, Links::Refuse).unwrap();
    let shape = |found: &[fsx::Inside]| {
        let mut shape: Vec<_> = found
            .iter()
            .map(|inside| (inside.path.clone(), inside.file.map(|stat| (stat.bytes, stat.executable))))
            .collect();
        shape.sort();
        shape
    };
    assert_eq!(shape(&before), shape(&after));
    assert_eq!(std::fs::read_to_string(laid.join("deep/er/a b")).unwrap(), "one");
    assert_eq!(before.len(), 3);
}

#[test]
fn times_owners_and_the_order_of_making_do_not_matter() {
    let (place, store) = store();
    let mut digests = Vec::new();
    for (name, order) in [("x", ["a", "b"]), ("y", ["b", "a"])] {
        let folder = place.path().join(name);
        std::fs::create_dir(&folder).unwrap();
        order.iter().for_each(|file| std::fs::write(folder.join(file), file).unwrap());
        digests.push(store.take_folder(&folder).unwrap().digest);
    }
    assert_eq!(digests[0], digests[1]);
}

#[test]
fn a_link_in_a_folder_is_refused_with_its_path() {
    let (place, store) = store();
    let folder = place.path().join("made");
    std::fs::create_dir(&folder).unwrap();
    std::os::unix::fs::symlink("/etc/hostname", folder.join("link")).unwrap();
    let said = store.take_folder(&folder).unwrap_err().to_string();
    assert!(said.contains("made/link") && said.contains("symbolic link"), "{said}");
}

#[test]
fn a_folder_that_lost_a_file_is_not_there() {
    let (place, store) = store();
    let folder = place.path().join("made");
    std::fs::create_dir(&folder).unwrap();
    std::fs::write(folder.join("a"), "content").unwrap();
    let digest = store.take_folder(&folder).unwrap().digest;
    assert!(store.has_folder(&digest).unwrap());
    std::fs::remove_file(store.blob_path(&Digest::of(b"content"))).unwrap();
    assert!(!store.has_folder(&digest).unwrap());
    assert!(store.lay_out(&digest, &place.path().join("laid")).is_err());
}

#[test]
fn a_list_that_leads_out_of_its_folder_is_no_list() {
    let line = |path: &str| format!("dril-folder 1\n{} 3 - {path}\n", Digest::of(b"abc"));
    assert!(Folder::parse(line("a").as_bytes()).is_ok());
    for path in [
        "../a",
        "/etc/passwd",
        "a/../../b",
        "",
        ".",
        "./a",
        "a//b",
        "a/",
        "%2e%2e/a",
        "a%",
        "a%2",
        "a%00",
        "%41",
    ] {
        assert!(Folder::parse(line(path).as_bytes()).is_err(), "{path}");
    }
    let both = format!("dril-folder 1\n{0} 3 - a\n{0} 3 - a/b\n", Digest::of(b"abc"));
    assert!(Folder::parse(both.as_bytes()).is_err(), "a file that is also a folder");
    assert!(Folder::parse(b"dril-folder 2\n").is_err());
}

proptest! {
    #[test]
    fn any_names_survive_the_list(names in proptest::collection::btree_set(proptest::collection::vec(1u8..=255, 1..6), 0..8)) {
        let usable = names.into_iter().filter(|name| !name.contains(&b'/') && name != b"." && name != b"..");
        let entries = usable.map(|name| FolderEntry { path: OsString::from_vec(name).into(), ..file("", "x") });
        let folder = Folder::new(entries.collect());
        prop_assert_eq!(Folder::parse(&folder.to_bytes()), Ok(folder));
    }

    #[test]
    fn no_bytes_are_too_much_for_the_reader(bytes in proptest::collection::vec(any::<u8>(), 0..80)) {
        let _ = Folder::parse(&bytes);
        let _ = Folder::parse(&[b"dril-folder 1\n".as_slice(), &bytes].concat());
    }
}
