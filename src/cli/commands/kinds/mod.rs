//! `dril-pipe kinds`: the stage kinds with their parameters, inputs and outputs.

mod schema;

use std::process::ExitCode;

use dril_stage_api::{Arity, Kind, Ports, Registry};
use serde_json::{Map, Value, json};

use crate::cli::args::KindsArgs;
use crate::cli::columns;
use crate::cli::terminal::{Style, Terminal, print};
use crate::error::{Error, ErrorKind};
use crate::spec::suggest;

/// The width of wrapped text where the output has no width.
const PROSE: usize = 110;

pub(in crate::cli) fn main(args: &KindsArgs, registry: &Registry) -> Result<ExitCode, Error> {
    let terminal = Terminal::stdout();
    let text = match &args.kind {
        None if args.json => format!("{:#}\n", registry.iter().map(as_json).collect::<Value>()),
        None => list(registry, terminal),
        Some(name) => {
            let kind = registry.get(name).ok_or_else(|| unknown(name, registry))?;
            if args.json { format!("{:#}\n", as_json(kind)) } else { describe(kind, terminal) }
        }
    };
    print(&text)?;
    Ok(ExitCode::SUCCESS)
}

fn unknown(name: &str, registry: &Registry) -> Error {
    let names: Vec<&str> = registry.iter().map(Kind::name).collect();
    Error::new(ErrorKind::Usage, format!("there is no stage kind `{name}`")).hint(suggest::hint(
        name,
        "the kinds",
        names,
    ))
}

fn list(registry: &Registry, terminal: Terminal) -> String {
    let rows: Vec<Vec<String>> =
        registry.iter().map(|kind| vec![kind.name().to_owned(), kind.about().to_owned()]).collect();
    if rows.is_empty() {
        return "this build has no stage kinds\n".to_owned();
    }
    columns(&rows, terminal)
}

fn describe(kind: &Kind, terminal: Terminal) -> String {
    let heading = |text: &str| format!("\n{}\n", terminal.paint(Style::Strong, text));
    let seed = if kind.seeded() { "seeded" } else { "not seeded" };
    let mut text = format!("{}: {}\n", terminal.paint(Style::Strong, kind.name()), kind.about());
    text += &format!("revision {}, {seed}\n", kind.revision());
    let schema = kind.schema();
    let fields = schema::fields(schema.as_value());
    if !fields.is_empty() {
        text += &heading("parameters (`with:`)");
        let rows =
            fields.into_iter().map(|field| vec![field.path, field.accepts, field.default, field.about]);
        text += &columns(&rows.collect::<Vec<_>>(), terminal);
    }
    let Some(ports) = ports(kind, schema.as_value()) else {
        return text + "\ninputs and outputs depend on the parameters\n";
    };
    if !ports.inputs.is_empty() {
        text += &heading("inputs");
        let row = |input: &dril_stage_api::Input| {
            vec![input.name.into(), input.artifact.to_string(), arity(input.arity).into(), input.about.into()]
        };
        text += &columns(&ports.inputs.iter().map(row).collect::<Vec<_>>(), terminal);
    }
    text += &heading("outputs");
    let row = |output: &dril_stage_api::Output| {
        let extension = format!(".{}", output.extension);
        vec![output.name.into(), output.artifact.to_string(), extension, output.about.into()]
    };
    text + &columns(&ports.outputs.iter().map(row).collect::<Vec<_>>(), terminal)
}

fn columns(rows: &[Vec<String>], terminal: Terminal) -> String {
    let paint = |column, cell: String| if column == 0 { terminal.paint(Style::Hint, &cell) } else { cell };
    columns::render(rows, terminal.width.unwrap_or(PROSE), &paint)
}

fn arity(arity: Arity) -> &'static str {
    match arity {
        Arity::One => "one",
        Arity::Optional => "optional",
        Arity::Many => "many",
    }
}

/// The ports with the kind's default parameters, and placeholder values for required ones.
fn ports(kind: &Kind, schema: &Value) -> Option<Ports> {
    let defaults = kind.ports(&Value::Object(Map::new()));
    defaults.or_else(|_| kind.ports(&schema::sample(schema))).ok()
}

fn as_json(kind: &Kind) -> Value {
    let schema = kind.schema();
    let ports = ports(kind, schema.as_value());
    let inputs = ports.iter().flat_map(|ports| &ports.inputs).map(|input| {
        json!({
            "name": input.name, "artifact": input.artifact, "arity": arity(input.arity), "about": input.about,
        })
    });
    let outputs = ports.iter().flat_map(|ports| &ports.outputs).map(|output| {
        json!({
            "name": output.name, "artifact": output.artifact, "extension": output.extension,
            "about": output.about,
        })
    });
    json!({
        "kind": kind.name(),
        "about": kind.about(),
        "revision": kind.revision(),
        "seeded": kind.seeded(),
        "inputs": inputs.collect::<Vec<_>>(),
        "outputs": outputs.collect::<Vec<_>>(),
        "params": schema.as_value(),
    })
}
