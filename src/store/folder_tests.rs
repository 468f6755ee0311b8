//! Folders as artifacts: what is kept, what is refused, and the format that stays.

use std::os::unix::fs::PermissionsExt;

use proptest::prelude::*;

use super::*;

fn file(path: &str, text: &str) -> FolderEntry {
    let file =
        FolderFile { digest: Digest::of(text.as_bytes()), bytes: text.len() as u64, executable: false };
    FolderEntry { path: path.into(), what: Part::File(file) }
}

fn store() -> (tempfile::TempDir, Store) {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(&folder.path().join("store")).unwrap();
    (folder, store)
}

#[test]
fn the_list_of_a_folder_never_changes() {
    let (digest, bytes) = (Digest::of(b"#!"), 2);
    let what = Part::File(FolderFile { digest, bytes, executable: true });
    let tool = FolderEntry { path: "bin/tool".into(), what };
    let empty = FolderEntry { path: "logs".into(), what: Part::Empty };
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
    for (link, to) in
        [("last", "run"), ("deep/up", "../run"), ("to-folder", "deep/er"), ("deep/er/own", "../er")]
    {
        std::os::unix::fs::symlink(to, made.join(link)).unwrap();
    }
    std::fs::write(made.join("deep/er/a b"), "one").unwrap();
    std::fs::write(made.join("run"), "#!/bin/sh\n").unwrap();
    std::fs::set_permissions(made.join("run"), std::fs::Permissions::from_mode(0o755)).unwrap();
    let before = fsx::walk(&made, Links::Keep, &fsx::nothing).unwrap();
    let blob = store.take_folder(&made).unwrap();
    blob.sync().unwrap();
    let laid = place.path().join("laid");
    store.lay_out(&blob.digest, &laid).unwrap();
    let after = fsx::walk(&laid, Links::Keep, &fsx::nothing).unwrap();
    let shape = |found: &[fsx::Inside]| {
        let mut shape: Vec<_> = found
            .iter()
            .map(|inside| {
                let what = match &inside.what {
                    What::File(stat) => format!("{} {}", stat.bytes, stat.executable),
                    other => format!("{other:?}"),
                };
                (inside.path.clone(), what)
            })
            .collect();
        shape.sort();
        shape
    };
    assert_eq!(shape(&before), shape(&after));
    assert_eq!(std::fs::read_to_string(laid.join("deep/er/a b")).unwrap(), "one");
    assert_eq!(before.len(), 7);
    let own = place.path().join("copies");
    store.copy_out_folder(&blob.digest, &own).unwrap();
    assert_eq!(shape(&before), shape(&fsx::walk(&own, Links::Keep, &fsx::nothing).unwrap()));
    assert_eq!(hash_folder(&own).unwrap().digest(), blob.digest);
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
fn a_link_is_kept_where_it_leads_inside_and_taken_for_its_file_where_it_leads_to_one_outside() {
    let (place, store) = store();
    let made = place.path().join("made");
    std::fs::create_dir_all(made.join("a/b")).unwrap();
    std::fs::write(made.join("a/f"), "inside").unwrap();
    std::fs::write(place.path().join("outside"), "outside").unwrap();
    for (link, to) in [
        ("absolute", made.join("a/f")),
        ("round", "a/../a/b/../f".into()),
        ("a/b/chain", "../../absolute".into()),
        ("a/up", made.clone()),
        ("copied", place.path().join("outside")),
    ] {
        std::os::unix::fs::symlink(to, made.join(link)).unwrap();
    }
    let digest = store.take_folder(&made).unwrap().digest;
    std::fs::remove_dir_all(&made).unwrap();
    let folder = store.folder(&digest).unwrap().unwrap();
    let link =
        |path: &str| match &folder.entries().iter().find(|entry| entry.path == Path::new(path)).unwrap().what
        {
            Part::Link(to) => to.to_str().unwrap().to_owned(),
            other => panic!("{path}: {other:?}"),
        };
    assert_eq!(["absolute", "round", "a/b/chain", "a/up"].map(link), ["a/f", "a/f", "../../absolute", ".."]);
    let laid = place.path().join("laid");
    store.copy_out_folder(&digest, &laid).unwrap();
    for (file, text) in
        [("round", "inside"), ("a/b/chain", "inside"), ("copied", "outside"), ("a/up/a/f", "inside")]
    {
        assert_eq!(std::fs::read_to_string(laid.join(file)).unwrap(), text, "{file}");
    }
}

#[test]
fn a_link_that_leads_nowhere_is_named_with_where_it_leads() {
    let (place, store) = store();
    for (to, expected) in [("gone", "the link is broken"), ("link", "circular"), ("/etc", "a folder outside")]
    {
        let folder = place.path().join("made");
        std::fs::create_dir(&folder).unwrap();
        std::os::unix::fs::symlink(to, folder.join("link")).unwrap();
        let said = store.take_folder(&folder).unwrap_err().to_string();
        assert!(
            said.contains("made/link") && said.contains(&format!("`{to}`")) && said.contains(expected),
            "{said}"
        );
        std::fs::remove_dir_all(&folder).unwrap();
    }
}

#[test]
fn a_link_of_a_list_leads_to_no_place_outside_its_folder() {
    let line = |to: &str, path: &str| format!("dril-folder 1\n{to} 0 l {path}\n");
    for (to, path) in [("f", "a"), ("../f", "d/a"), ("..", "d/a"), ("d/e", "a")] {
        assert!(Folder::parse(line(to, path).as_bytes()).is_ok(), "{to} {path}");
    }
    for (to, path) in [
        ("../f", "a"),
        ("/etc/passwd", "a"),
        ("d/../f", "a"),
        ("../../f", "d/a"),
        (".", "a"),
        ("", "a"),
        ("f//g", "a"),
    ] {
        assert!(Folder::parse(line(to, path).as_bytes()).is_err(), "{to} {path}");
    }
    let through = format!("dril-folder 1\nd 0 l a\n{} 3 - a/b\n", Digest::of(b"abc"));
    assert!(Folder::parse(through.as_bytes()).is_err(), "a file behind a link");
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
