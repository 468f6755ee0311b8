//! Where a command finds its inputs: at the declared paths, as files and folders of its own.

use crate::sealed::{Ended, Sealed, ended};

/// Runs the program with the PATH of the tests, so that it finds Python.
fn run(sealed: &Sealed, args: &str) -> Ended {
    let mut command = sealed.command(args);
    command.env("PATH", std::env::var_os("PATH").unwrap());
    ended(command)
}

const SCRIPT: &str = "\
name: p
stages:
  tool: { kind: command, with: { shell: \"printf '#!/bin/sh\\necho ran\\n' > {outputs.x}; chmod +x {outputs.x}\", outputs: { x: x } } }
  made: { kind: command, with: { shell: \"mkdir -p {outputs.d}/sub {outputs.d}/empty; echo b > {outputs.d}/sub/b; ln -s sub {outputs.d}/latest\", outputs: { d: d/ } } }
  say: { kind: emit, with: { text: twice } }
  use:
    kind: command
    with:
      run: [python3, \"{inputs.s}\", \"{outputs.t}\"]
      inputs: { s: main.py, common: common.py, x: bin/tool, d: data/made/, one: data/one.txt, two: data/two.txt, parts: { path: parts, many: true } }
      outputs: { t: { type: table, path: t.csv } }
    inputs: { s: { file: main.py }, common: { file: common.py }, x: tool, d: made, one: say, two: say, parts: [say, tool] }
";

const MAIN: &str = "\
import os, pathlib, subprocess, sys
import common
here = pathlib.Path.cwd().resolve()
assert pathlib.Path(__file__).resolve() == here / 'main.py', __file__
assert pathlib.Path(sys.path[0]).resolve() == here, sys.path
for path in ['main.py', 'common.py', 'bin/tool', 'data/one.txt', 'data/two.txt', 'data/made/sub/b', 'parts/0', 'parts/1']:
    assert (here / path).resolve() == here / path, (here / path).resolve()
    assert (here / path).stat().st_mode & 0o222 == 0, path
assert os.readlink('data/made/latest') == 'sub' and os.path.isdir('data/made/empty')
assert open('data/one.txt').read() == open('data/two.txt').read() == open('parts/0').read() == 'twice'
said = subprocess.run(['bin/tool'], capture_output=True, text=True, check=True).stdout
open(sys.argv[1], 'w').write(common.WORD + ' ' + said)
";

#[test]
fn a_script_imports_what_is_declared_beside_it_and_inputs_lie_at_their_paths() {
    let sealed = Sealed::with(SCRIPT);
    sealed.write("main.py", MAIN);
    sealed.write("common.py", "WORD = 'imported'\n");
    let said = run(&sealed, "run p.yaml");
    assert_eq!(said.code, 0, "{said:?}");
    assert_eq!(sealed.read("results/p-default/use.csv"), "imported ran\n");
    assert!(run(&sealed, "run p.yaml").stdout.contains("0 stages executed"));
}

const MOVED: &str = "\
name: p
stages:
  made: { kind: command, with: { shell: \"mkdir -p {outputs.d}/sub; echo a > {outputs.d}/sub/a\", outputs: { d: d/ } } }
  say: { kind: emit, with: { text: word } }
  move:
    kind: command
    with:
      shell: \"mv {inputs.d} {outputs.e}; mv {inputs.f} {outputs.g}; ln -s ../{inputs.again} {outputs.h}; chmod u+w {outputs.g}\"
      inputs: { again: ~ }
      outputs: { e: e/, g: outputs/g.txt, h: outputs/h/ }
    inputs: { d: made, f: say, again: made }
  look:
    kind: command
    with: { shell: \"cat {inputs.e}/sub/a {inputs.h}/sub/a {inputs.g} > {outputs.t}\", outputs: { t: { type: table, path: t.csv } } }
    inputs: { e: move.e, g: move.g, h: move.h }
";

#[test]
fn an_input_may_become_an_output() {
    use std::os::unix::fs::MetadataExt;
    let sealed = Sealed::with(MOVED);
    let said = run(&sealed, "run p.yaml");
    assert_eq!(said.code, 0, "{said:?}");
    assert_eq!(sealed.read("results/p-default/look.csv"), "a\na\nword");
    for blob in crate::lab::files_below(&sealed.path("cache/blobs-v1")) {
        let meta = std::fs::metadata(sealed.path(&format!("cache/blobs-v1/{blob}"))).unwrap();
        assert_eq!((meta.nlink(), meta.mode() & 0o222), (1, 0), "{blob}");
    }
    assert_eq!(run(&sealed, "cache verify").code, 0);
}
