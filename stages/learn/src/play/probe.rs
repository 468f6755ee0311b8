//! The stage that looks at what an agent would do at one recorded observation.

use dril_envs::{Demonstrations, DemosHeader, EnvError, Episode, ObservationSpace, RgbImage};
use dril_kinds::{Network, Probe, ProbeParams};
use dril_stage_api::{Ctx, Stage, StageError, math};

use crate::data::frames::FrameStore;
use crate::data::transitions::frames_of;
use crate::policy::{Architecture, Parts, Policy, Row, to_action};

/// Runs the kind `probe`.
pub struct ProbeStage;

/// So many times as wide and tall as it was recorded, an image is shown.
const ENLARGED: usize = 2;
/// Columns of a drawing of the environment.
const WIDTH: f64 = 360.0;

impl Stage for ProbeStage {
    type Kind = Probe;

    fn run(params: &ProbeParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        let moment = Moment::load(params, ctx)?;
        let policy = match params.fresh {
            None => Policy::load("policy", ctx.input("policy")?)?,
            Some(family) => {
                let observation = moment.header.observation_space;
                let network = params.network.unwrap_or(match observation {
                    ObservationSpace::Image { .. } => Network::DrilCnn,
                    ObservationSpace::Vector { .. } => Network::Mlp,
                });
                let actions = moment.header.env.spaces().map_err(StageError::failed)?.1;
                let architecture = Architecture { network, family, observation, actions };
                Policy::new(architecture, &mut ctx.stream("init"))?
            }
        };
        let seen = moment.header.observation_space;
        if policy.architecture().observation != seen
            || policy.architecture().action_len() != moment.header.action_dims
        {
            return Err(StageError::failed(format!(
                "the policy sees {:?} and gives {} values, but the recording shows {seen:?} and has {}; give it a \
                 recording of the environment that the policy was trained in",
                policy.architecture().observation,
                policy.architecture().action_len(),
                moment.header.action_dims
            )));
        }
        let answers = policy.infer(&moment.observation(&policy), Parts::Actor);
        let row = policy.row(&answers, 0);
        ctx.write_output("distribution", distribution(row, moment.expert())?)?;
        ctx.write_output("draws", draws(params, &policy, row, moment.expert(), ctx)?)?;
        if params.image {
            let image = moment.image().and_then(|image| image.to_png()).map_err(StageError::failed)?;
            ctx.write_output("image", image)?;
        }
        Ok(())
    }
}

/// One step of a recording.
struct Moment {
    header: DemosHeader,
    episode: Episode,
    step: usize,
}

impl Moment {
    fn load(params: &ProbeParams, ctx: &Ctx<'_>) -> Result<Self, StageError> {
        let path = ctx.input("demonstrations")?;
        let wrong = |message: String| StageError::input("demonstrations", path, message);
        let mut demos = Demonstrations::read(path).map_err(|error| wrong(error.to_string()))?;
        let (count, at, step) = (demos.episodes.len(), params.episode as usize, params.step as usize);
        if at >= count {
            return Err(wrong(format!(
                "has {count} episodes, expected one with the number {at} (`episode`)"
            )));
        }
        let episode = demos.episodes.swap_remove(at);
        let steps = episode.steps(demos.header.action_dims);
        if step >= steps {
            let message =
                format!("episode {at} has {steps} steps, expected one with the number {step} (`step`)");
            return Err(wrong(message));
        }
        Ok(Self { header: demos.header, episode, step })
    }

    /// What the agent sees, as its network takes it.
    fn observation(&self, policy: &Policy) -> crate::nn::Batch {
        let mut frames = FrameStore::with_slots(self.header.observation_space, self.step + 1);
        for (slot, frame) in
            frames_of(&self.episode, &self.header.observation_space).take(self.step + 1).enumerate()
        {
            frames.set_scaled(slot, frame, slot == 0, policy.statistics.as_ref());
        }
        frames.gather(&[self.step])
    }

    /// What the expert did.
    fn expert(&self) -> &[f32] {
        let dims = self.header.action_dims;
        &self.episode.actions[self.step * dims..][..dims]
    }

    /// The frames that the agent sees at once, or a drawing of the environment at that moment.
    fn image(&self) -> Result<RgbImage, EnvError> {
        if let ObservationSpace::Image { height, width, stack } = self.header.observation_space {
            let frame = |at: usize| {
                let grey = &self.episode.frames[at * height * width..][..height * width];
                RgbImage::from_grey(width, height, grey).enlarged(ENLARGED)
            };
            let first = (self.step + 1).saturating_sub(stack);
            return Ok(RgbImage::strip(&(first..=self.step).map(frame).collect::<Vec<_>>()));
        }
        let mut env = self.header.env.build()?;
        env.reset(self.episode.seed)?;
        for action in self.episode.actions.chunks_exact(self.header.action_dims.max(1)).take(self.step) {
            env.step(action)?;
        }
        env.render(WIDTH as usize, (WIDTH / self.header.env.aspect_ratio()).round() as usize)
    }
}

/// The output `distribution`, in the scale of actions; what a family does not have is empty.
fn distribution(row: Row<'_>, expert: &[f32]) -> Result<Vec<u8>, StageError> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let header = ["dimension", "mean", "deviation", "alpha", "beta", "probability", "expert"];
    writer.write_record(header).map_err(StageError::failed)?;
    let mut write = |n: usize, values: [Option<f64>; 5], expert: f64| {
        let values = values.into_iter().chain([Some(expert)]);
        let cells = values.map(|value| value.map_or_else(String::new, |value| value.to_string()));
        let cells: Vec<String> = std::iter::once(n.to_string()).chain(cells).collect();
        writer.write_record(cells).map_err(StageError::failed)
    };
    match row {
        Row::Gaussian { mean, log_std } => {
            for (n, (mean, log_std)) in mean.iter().zip(log_std).enumerate() {
                let deviation = math::exp(f64::from(*log_std));
                let values = [Some(f64::from(*mean)), Some(deviation), None, None, None];
                write(n, values, f64::from(expert[n]))?;
            }
        }
        Row::Beta { u, w } => {
            for (n, (u, w)) in u.iter().zip(w).enumerate() {
                let [alpha, beta] = [u, w].map(|raw| math::softplus(f64::from(*raw)) + 1.0);
                let sum = alpha + beta;
                // Twice those of the interval from 0 to 1.
                let mean = 2.0 * alpha / sum - 1.0;
                let deviation = 2.0 * (alpha * beta / (sum * sum * (sum + 1.0))).sqrt();
                let values = [Some(mean), Some(deviation), Some(alpha), Some(beta), None];
                write(n, values, f64::from(expert[n]))?;
            }
        }
        Row::Categorical { logits } => {
            for choice in 0..logits.len() {
                let probability = math::exp(row.log_prob(&[choice as f32]));
                let chosen = if expert[0] == choice as f32 { 1.0 } else { 0.0 };
                write(choice, [None, None, None, None, Some(probability)], chosen)?;
            }
        }
    }
    writer.into_inner().map_err(StageError::failed)
}

/// The output `draws`: actions as the agent gives them, not clipped.
fn draws(
    params: &ProbeParams,
    policy: &Policy,
    row: Row<'_>,
    expert: &[f32],
    ctx: &Ctx<'_>,
) -> Result<Vec<u8>, StageError> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let names = |what: &'static str| (0..expert.len()).map(move |n| format!("{what}_{n}"));
    let header = std::iter::once("draw".to_owned()).chain(names("action")).chain(names("expert"));
    writer.write_record(header).map_err(StageError::failed)?;
    let mut stream = ctx.stream("draws");
    let mut sample = vec![0.0; expert.len()];
    for draw in 0..params.draws {
        row.sample(&mut stream, &mut sample);
        let actions = sample.iter().map(|value| to_action(policy.architecture().family, *value));
        let cells = actions.chain(expert.iter().copied()).map(|value| value.to_string());
        writer.write_record(std::iter::once(draw.to_string()).chain(cells)).map_err(StageError::failed)?;
    }
    writer.into_inner().map_err(StageError::failed)
}

#[cfg(test)]
#[path = "probe_tests.rs"]
mod tests;
