//! What each kind of environment answers about itself, from its settings alone.

use crate::{ActionSpace, Env, EnvError, ObservationSpace};

/// The settings of one kind of environment, and what follows from them.
pub trait EnvSettings {
    /// Every field that is out of range: its name, and what was seen and expected.
    fn check(&self) -> Vec<(String, String)>;

    /// `count` environments, before their first episodes. Environments that run in other processes share at most
    /// `workers` of these.
    ///
    /// # Errors
    /// A program or package that the environment needs is missing.
    fn build(&self, count: usize, workers: usize) -> Result<Vec<Box<dyn Env>>, EnvError>;

    /// Observation and action space, where they are known without starting another program.
    fn known_spaces(&self) -> Option<(ObservationSpace, ActionSpace)>;

    /// Observation and action space. May start another program and ask it; by default, those that are known.
    ///
    /// # Errors
    /// That program cannot be started, or does not know the environment.
    fn spaces(&self) -> Result<(ObservationSpace, ActionSpace), EnvError> {
        let message = "its spaces are not known before it is built".to_owned();
        self.known_spaces().ok_or(EnvError::Config { field: "env".to_owned(), message })
    }

    /// Short names of the action's values (or of the choices), for display; there may be fewer names than values.
    fn action_labels(&self) -> &'static [&'static str];

    /// Steps per second of simulated time.
    fn steps_per_second(&self) -> f64;

    /// Width divided by height of a rendered image.
    fn aspect_ratio(&self) -> f64;
}

/// `count` environments of a type, for [`EnvSettings::build`].
pub(crate) fn several<E: Env + 'static>(count: usize, make: impl Fn() -> E) -> Vec<Box<dyn Env>> {
    (0..count).map(|_| Box::new(make()) as Box<dyn Env>).collect()
}
