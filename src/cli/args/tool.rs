//! The command line of a tool, from its description.

use std::path::{Path, PathBuf};

use clap::{Arg, ArgMatches, Args, FromArgMatches, value_parser};
use dril_stage_api::{Tool, ToolOption, ToolValue};
use serde_json::{Map, Number, Value};

use super::{PipelineArgs, StoreArgs};

/// The arguments of a tool.
#[derive(Debug)]
pub(in crate::cli) struct ToolArgs {
    /// The artifact as given: a file, or `FILE:STAGE.OUTPUT`.
    pub artifact: String,
    /// The value of every option; `null` where it is not given and has no default.
    pub options: Map<String, Value>,
    /// The store of the pipeline.
    pub store: StoreArgs,
    profile: Option<String>,
    set: Vec<String>,
}

impl ToolArgs {
    /// The pipeline in `file` with the choices of the command line.
    pub fn pipeline(&self, file: &str) -> PipelineArgs {
        PipelineArgs { file: file.into(), profile: self.profile.clone(), set: self.set.clone() }
    }
}

/// The choices for the pipeline that an artifact comes from.
#[derive(Debug, Args)]
struct Choices {
    /// The pipeline's profile [default: the first one of the file]
    #[arg(short, long, value_name = "NAME")]
    profile: Option<String>,
    /// Override a value of the pipeline; can be repeated
    #[arg(short, long, value_name = "PATH=VALUE")]
    set: Vec<String>,
    #[command(flatten)]
    store: StoreArgs,
}

pub(super) fn command(tool: &Tool) -> clap::Command {
    let artifact = Arg::new("artifact").value_name(tool.value_name).required(true).help(tool.artifact_about);
    let examples: String = tool.examples.iter().map(|example| format!("\n  {example}")).collect();
    let mut command = clap::Command::new(tool.name).arg(artifact);
    if !examples.is_empty() {
        command = command.after_help(format!("Examples:{examples}"));
    }
    // Last, since the shared arguments bring a description of their own.
    Choices::augment_args(command.args(tool.options.iter().map(option))).about(tool.about)
}

fn option(option: &ToolOption) -> Arg {
    let arg = Arg::new(option.name)
        .long(option.name)
        .help(option.about)
        .required(option.required)
        .default_value(option.default);
    // The file to write has the same short name in every command.
    match option.value {
        ToolValue::Count => arg.value_name("N").value_parser(value_parser!(u64)),
        ToolValue::Number => arg.value_name("NUMBER").value_parser(number),
        ToolValue::Yaml(_) => arg.value_name("YAML"),
        ToolValue::Choice(words) => arg.value_name("CHOICE").value_parser(words.to_vec()),
        ToolValue::NewFile(..) => arg.short('o').value_name("FILE").value_parser(value_parser!(PathBuf)),
    }
}

fn number(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|number: &f64| number.is_finite()).ok_or_else(|| "expected a number".to_owned())
}

pub(super) fn read(tool: &Tool, matches: &ArgMatches) -> Result<ToolArgs, clap::Error> {
    let Choices { profile, set, store } = Choices::from_arg_matches(matches)?;
    let artifact = matches.get_one::<String>("artifact").cloned().unwrap_or_default();
    let options = tool.options.iter().map(|option| (option.name.to_owned(), value(option, matches)));
    Ok(ToolArgs { artifact, options: options.collect(), store, profile, set })
}

fn value(option: &ToolOption, matches: &ArgMatches) -> Value {
    let name = option.name;
    let value = match option.value {
        ToolValue::Count => matches.get_one::<u64>(name).map(|number| Value::from(*number)),
        ToolValue::Number => {
            let number = matches.get_one::<f64>(name);
            number.and_then(|number| Number::from_f64(*number)).map(Value::Number)
        }
        ToolValue::Yaml(_) | ToolValue::Choice(_) => {
            matches.get_one::<String>(name).map(|text| Value::from(text.as_str()))
        }
        ToolValue::NewFile(..) => {
            let path = matches.get_one::<PathBuf>(name);
            path.map(|path: &PathBuf| Value::from(Path::to_string_lossy(path)))
        }
    };
    value.unwrap_or(Value::Null)
}
