//! Tests of what the kinds accept, refuse and put into keys.

use super::*;
use dril_stage_api::ParamProblem;
use serde_json::{Value, json};

/// For each kind, what has to be set.
fn required() -> [(&'static str, Value); 9] {
    let env = json!({ "car-racing": {} });
    [
        ("ppo", json!({ "env": env, "policy": "gaussian" })),
        ("evaluate", json!({ "env": env, "mode": "stochastic", "first_seed": 1 })),
        ("collect", json!({ "env": env, "first_seed": 1 })),
        ("dataset", json!({ "actions": "clipped", "trajectories": 1 })),
        ("bc", json!({ "policy": "beta" })),
        ("ensemble", json!({})),
        ("dril", json!({ "env": env })),
        ("trace", json!({})),
        ("probe", json!({})),
    ]
}

fn kind(name: &str) -> Kind {
    *KINDS.iter().find(|kind| kind.name() == name).unwrap()
}

/// What the kind makes of its required parameters and `more`.
fn normalize(name: &str, more: &Value) -> Result<Value, Vec<ParamProblem>> {
    let mut params = required().into_iter().find(|(kind, _)| *kind == name).unwrap().1;
    for (field, value) in more.as_object().unwrap() {
        params[field] = value.clone();
    }
    kind(name).normalize(&params)
}

/// The fields that the kind finds wrong, sorted.
fn wrong_fields(name: &str, more: &Value) -> Vec<String> {
    let problems = normalize(name, more).unwrap_err();
    let mut paths: Vec<String> = problems.iter().map(|problem| problem.path.join(".")).collect();
    paths.sort();
    paths
}

/// The message about the one wrong field.
fn message(name: &str, more: &Value) -> String {
    let problems = normalize(name, more).unwrap_err();
    assert_eq!(problems.len(), 1, "{problems:?}");
    problems[0].message.clone()
}

#[test]
fn every_kind_takes_its_own_defaults() {
    for (kind, (name, params)) in KINDS.iter().zip(required()) {
        assert_eq!(kind.name(), name);
        let full = kind.normalize(&params).unwrap_or_else(|problems| panic!("{name}: {problems:?}"));
        assert_eq!(kind.normalize(&full), Ok(full.clone()), "{name}: normalising twice changes nothing");
        assert!(!kind.ports(&full).unwrap().outputs.is_empty());
        assert!(kind.needs(&full).unwrap().cost > 0.0, "{name}");
    }
}

#[test]
fn every_parameter_is_in_the_key_whether_it_is_set_or_not() {
    for (kind, (name, params)) in KINDS.iter().zip(required()) {
        let full = kind.normalize(&params).unwrap();
        let schema = kind.schema();
        let fields = schema.get("properties").and_then(Value::as_object).unwrap();
        let in_key: Vec<&String> = full.as_object().unwrap().keys().collect();
        assert_eq!(in_key, fields.keys().collect::<Vec<_>>(), "{name}");
    }
}

#[test]
fn the_shared_parameters_have_the_same_defaults_in_both_kinds() {
    let (ppo, dril) = (normalize("ppo", &json!({})).unwrap(), normalize("dril", &json!({})).unwrap());
    let shared = json!({
        "total_timesteps": 2_998_272, "to_step": null, "n_envs": 4, "n_steps": 2048, "n_epochs": 10,
        "n_minibatches": 32, "learning_rate": 2.5e-4, "anneal_learning_rate": true, "clip_range": 0.2,
        "ent_coef": 0.0, "vf_coef": 0.5, "max_grad_norm": 0.5, "gamma": 0.99, "gae_lambda": 0.95,
        "adam_epsilon": 1e-5, "bootstrap_time_limits": true, "mean_action_probability": 0.0,
        "normalize_reward": false, "device": "cpu"
    });
    for (field, value) in shared.as_object().unwrap() {
        assert_eq!((&ppo[field], &dril[field]), (value, value), "{field}");
    }
    let mut parts = serde_json::to_value(OnPolicyParams::default()).unwrap();
    let Value::Object(update) = serde_json::to_value(UpdateParams::default()).unwrap() else { panic!() };
    parts.as_object_mut().unwrap().extend(update);
    assert_eq!(parts, shared, "the two structs have these fields and no others");
    assert_eq!(
        (&ppo["on_divergence"], &dril["on_divergence"]),
        (&json!("error"), &json!("keep-last-finite"))
    );
}

#[test]
fn the_schema_lists_the_shared_parameters_with_their_defaults() {
    for name in ["ppo", "dril"] {
        let schema = kind(name).schema().to_value();
        let field = &schema["properties"]["n_steps"];
        assert_eq!(field["default"], 2048, "{name}: {field}");
        assert!(field["description"].as_str().unwrap().contains("between updates"), "{name}: {field}");
        let denied =
            ["additionalProperties", "unevaluatedProperties"].iter().any(|word| schema[word] == false);
        assert!(denied, "{name}: unknown fields are denied: {schema:#}");
    }
}

#[test]
fn values_out_of_range_are_all_reported_at_once() {
    let values = json!({ "gamma": 1.5, "n_envs": 0, "learning_rate": -1.0, "initial_deviation": 0 });
    assert_eq!(wrong_fields("ppo", &values), ["gamma", "initial_deviation", "learning_rate", "n_envs"]);
}

#[test]
fn values_of_wrong_types_and_unknown_fields_are_all_reported_at_once() {
    let values = json!({ "gamma": "high", "n_envs": 1.5, "stagger": -1, "n_step": 5, "device": "gpu" });
    assert_eq!(wrong_fields("ppo", &values), ["device", "gamma", "n_envs", "n_step", "stagger"]);
    let problems = normalize("dril", &json!({ "n_step": 5 })).unwrap_err();
    let hint = problems[0].hint.as_deref().unwrap();
    assert!(hint.starts_with("did you mean `n_steps`?"), "{hint}");
    assert!(hint.contains("`quantile`"), "fields of the kind's own are known too: {hint}");
}

#[test]
fn former_names_give_an_error_that_names_the_new_one() {
    for (name, old, new) in [
        ("ppo", "total_steps", "total_timesteps"),
        ("ppo", "envs", "n_envs"),
        ("ppo", "rollout_steps", "n_steps"),
        ("ppo", "epochs", "n_epochs"),
        ("dril", "minibatches", "n_minibatches"),
        ("dril", "entropy_coef", "ent_coef"),
        ("dril", "value_coef", "vf_coef"),
        ("bc", "max_epochs", "n_epochs"),
        ("ensemble", "members", "n_members"),
        ("ensemble", "epochs", "n_epochs"),
        ("evaluate", "first_track_seed", "first_seed"),
        ("collect", "first_track_seed", "first_seed"),
    ] {
        assert_eq!(message(name, &json!({ old: 8 })), format!("`{old}` is now `{new}`"), "{name}");
        let schema = kind(name).schema().to_value();
        assert!(schema["properties"][new].is_object(), "{name} has no `{new}`");
        assert!(schema["properties"][old].is_null(), "{name} still has `{old}`");
    }
}

#[test]
fn parameters_that_are_no_more_say_what_to_do_instead() {
    for name in ["ppo", "bc", "ensemble", "dril"] {
        let problems = normalize(name, &json!({ "precision": "bf16" })).unwrap_err();
        assert_eq!(problems[0].message, "`precision` is no longer a parameter");
    }
    let problems = normalize("dril", &json!({ "peak": "after" })).unwrap_err();
    assert!(problems[0].hint.as_deref().unwrap().contains("`peak-after`"), "{problems:?}");
}

#[test]
fn a_rollout_that_does_not_fill_its_minibatches_is_refused() {
    let values = json!({ "n_envs": 1, "n_steps": 8, "n_minibatches": 32, "total_timesteps": 8 });
    assert_eq!(wrong_fields("ppo", &values), ["n_minibatches"]);
}

#[test]
fn a_total_that_is_no_whole_number_of_rollouts_is_refused_with_the_nearest_ones() {
    let values = json!({ "n_envs": 1, "n_steps": 512, "total_timesteps": 1000 });
    assert_eq!(
        message("ppo", &values),
        "`total_timesteps` is 1000, expected a multiple of one rollout, 512 steps (`n_envs` × `n_steps`), as 512 or 1024"
    );
    let too_short = json!({ "n_envs": 1, "n_steps": 512, "total_timesteps": 100 });
    assert!(message("dril", &too_short).ends_with(", as 512"));
    assert!(message("dril", &json!({ "total_timesteps": 0 })).ends_with(", as 8192"));
    assert!(message("dril", &json!({ "total_timesteps": 3_000_000 })).ends_with(", as 2998272 or 3006464"));
    assert!(message("dril", &json!({ "total_timesteps": u64::MAX })).contains("expected a multiple"));
    assert!(normalize("dril", &json!({ "total_timesteps": 3_006_464 })).is_ok());
}

#[test]
fn a_leg_ends_between_updates_and_within_the_whole() {
    let leg = |from: u64, to: u64| json!({ "n_envs": 1, "n_steps": 512, "total_timesteps": 2048, "from_step": from, "to_step": to });
    assert!(normalize("ppo", &leg(512, 1024)).is_ok());
    assert_eq!(wrong_fields("ppo", &leg(512, 1000)), ["to_step"]);
    assert_eq!(wrong_fields("ppo", &leg(500, 1024)), ["from_step"]);
    assert_eq!(wrong_fields("ppo", &leg(1024, 1024)), ["from_step"]);
    assert_eq!(wrong_fields("ppo", &leg(512, 4096)), ["to_step"]);
    assert!(normalize("dril", &json!({ "to_step": 8192 })).is_ok());
    assert_eq!(wrong_fields("dril", &json!({ "to_step": 8191 })), ["to_step"]);
    assert_eq!(wrong_fields("dril", &json!({ "to_step": 0 })), ["to_step"]);
}

#[test]
fn an_end_that_comes_early_costs_less() {
    let cost = |params: &Value| kind("dril").needs(&normalize("dril", params).unwrap()).unwrap().cost;
    assert!(cost(&json!({ "to_step": 8192 })) < cost(&json!({})) / 100.0);
}

#[test]
fn how_a_policy_begins_is_for_new_agents_of_families_that_have_it() {
    let fine = json!({ "initial_deviation": 0.5, "mean_gain": 0.01, "initial_mean": [0.0, 0.1] });
    assert!(normalize("ppo", &fine).is_ok());
    let mut beta = fine.clone();
    beta["policy"] = json!("beta");
    assert_eq!(wrong_fields("ppo", &beta), ["initial_deviation", "initial_mean"]);
    beta["policy"] = json!("categorical");
    assert_eq!(wrong_fields("ppo", &beta), ["initial_deviation", "initial_mean", "mean_gain"]);
    let mut later = fine;
    later["from_step"] = json!(8192);
    assert_eq!(wrong_fields("ppo", &later), ["initial_deviation", "initial_mean", "mean_gain"]);
    assert!(normalize("ppo", &json!({ "from_step": 8192 })).is_ok());
}

#[test]
fn initial_means_are_as_many_as_the_values_of_an_action() {
    assert_eq!(
        message("ppo", &json!({ "initial_mean": [0.1] })),
        "`initial_mean` has 1 numbers, expected 2, one per action dimension"
    );
    let elsewhere = json!({ "initial_mean": [0.1], "env": { "gymnasium": { "id": "Pendulum-v1" } } });
    assert!(normalize("ppo", &elsewhere).is_ok(), "planning looks up no environment of Gymnasium");
}

#[test]
fn dril_writes_the_weights_before_and_after_the_best_update() {
    let params = normalize("dril", &json!({})).unwrap();
    let ports = kind("dril").ports(&params).unwrap();
    let names: Vec<&str> = ports.outputs.iter().map(|output| output.name).collect();
    assert_eq!(names, ["peak", "peak-after", "final", "log", "episodes"]);
}

#[test]
fn what_trainings_log_is_known_before_they_run() {
    for (name, output, column) in [
        ("ppo", "log", "score_mean_10"),
        ("ppo", "episodes", "u_signal"),
        ("dril", "log", "peak_score"),
        ("dril", "log", "update"),
        ("dril", "episodes", "score"),
        ("bc", "log", "val_loss"),
        ("ensemble", "log", "val_loss"),
        ("evaluate", "scores", "score"),
    ] {
        let ports = kind(name).ports(&normalize(name, &json!({})).unwrap()).unwrap();
        let columns = ports.find_output(output).unwrap().columns.clone().unwrap();
        assert!(columns.contains(&column), "{name}.{output}: {columns:?}");
    }
}

#[test]
fn the_reward_may_be_constant() {
    assert_eq!(normalize("dril", &json!({ "reward": "constant" })).unwrap()["reward"], "constant");
    assert_eq!(normalize("dril", &json!({})).unwrap()["reward"], "plus-minus-one");
}

#[test]
fn a_trace_has_the_inputs_of_what_it_traces_and_draws_only_what_is_asked_for() {
    let ports = |params: &Value| {
        let ports = kind("trace").ports(&normalize("trace", params).unwrap()).unwrap();
        let names = |all: Vec<&'static str>| all.join(" ");
        (
            names(ports.inputs.iter().map(|input| input.name).collect()),
            names(ports.outputs.iter().map(|output| output.name).collect()),
        )
    };
    let played = ports(&json!({ "env": { "car-racing": {} }, "video": true }));
    assert_eq!(played, ("policy demonstrations ensemble".into(), "steps map strip video".into()));
    assert_eq!(ports(&json!({})), ("demonstrations ensemble".into(), "steps map".into()));
    assert_eq!(wrong_fields("trace", &json!({ "replay": false, "video": true })), ["video"]);
    assert_eq!(wrong_fields("trace", &json!({ "episodes": 0, "steps": 0 })), ["episodes", "steps"]);
}

#[test]
fn a_probe_of_a_new_agent_reads_no_policy() {
    let inputs = |params: &Value| {
        let ports = kind("probe").ports(&normalize("probe", params).unwrap()).unwrap();
        ports.inputs.iter().map(|input| input.name).collect::<Vec<_>>()
    };
    assert_eq!(inputs(&json!({})), ["policy", "demonstrations"]);
    assert_eq!(inputs(&json!({ "fresh": "beta", "network": "expert-cnn" })), ["demonstrations"]);
    assert_eq!(wrong_fields("probe", &json!({ "network": "mlp", "draws": 0 })), ["draws", "network"]);
}
