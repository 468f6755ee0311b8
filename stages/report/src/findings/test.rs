//! The test of a claim: the mean difference over its pairs, its interval, and p values for and against it.

use super::cells::{Cell, Pair, Training};
use super::params::{Claim, Relation};
use crate::inference::{self, FEWEST_EPISODES, FEWEST_TRAININGS, Over};

/// Independent values of a difference, and their unit of analysis.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Differences {
    pub(crate) values: Vec<f64>,
    pub(crate) over: Over,
}

/// What was measured of a claim.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Measured {
    /// The mean difference, over all pairs.
    pub(crate) all: Differences,
    /// That of each pair.
    pub(crate) pairs: Vec<Differences>,
}

/// How a claim stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The difference is as claimed.
    Holds,
    /// The opposite holds.
    Contradicted,
    /// The data do not decide.
    Undecided,
}

impl Verdict {
    /// Its word in the outputs.
    pub fn name(self) -> &'static str {
        match self {
            Self::Holds => "holds",
            Self::Contradicted => "contradicted",
            Self::Undecided => "undecided",
        }
    }
}

/// Measures a claim on its pairs.
pub(crate) fn measure(claim: &Claim, pairs: &[Pair<'_>]) -> Measured {
    let chooses = !claim.best_of.is_empty();
    let differences: Vec<Differences> = pairs.iter().map(|pair| difference(pair, chooses)).collect();
    let over = differences.iter().map(|pair| pair.over).min().unwrap_or(Over::Episodes);
    // One value a training, or a track: the mean over the pairs, which share them.
    let count = differences.iter().map(|pair| pair.values.len()).min().unwrap_or(0);
    let comparable = differences.iter().all(|pair| pair.over == over && pair.values.len() == count);
    let mean = |n: usize| inference::mean(&differences.iter().map(|pair| pair.values[n]).collect::<Vec<_>>());
    let values = if comparable { (0..count).filter_map(mean).collect() } else { Vec::new() };
    Measured { all: Differences { values, over }, pairs: differences }
}

fn difference(pair: &Pair<'_>, chooses: bool) -> Differences {
    let (left, right) = (best(&pair.left, chooses), best(&pair.right, chooses));
    let over =
        if left.trainings.len() > 1 || right.trainings.len() > 1 { Over::Trainings } else { Over::Episodes };
    let both = left.trainings.iter().filter_map(|training| {
        Some((training, right.trainings.iter().find(|other| other.key == training.key)?))
    });
    let values = both.flat_map(|(left, right)| {
        let tracks = tracks(left, right, chooses);
        match over {
            Over::Episodes => tracks,
            Over::Trainings => inference::mean(&tracks).into_iter().collect(),
        }
    });
    Differences { values: values.collect(), over }
}

/// The differences on the tracks that both played, in the order of the left; of the second, fourth, ... where the others
/// were used to choose.
fn tracks(left: &Training, right: &Training, chooses: bool) -> Vec<f64> {
    // Evaluations are played on one list of tracks, so the counterpart mostly stands at the same place.
    let same = left.episodes.len() == right.episodes.len()
        && left.episodes.iter().zip(&right.episodes).all(|(a, b)| a.0 == b.0);
    let counterpart = |n: usize, track: u64| {
        if same { right.episodes.get(n) } else { right.episodes.iter().find(|other| other.0 == track) }
    };
    let all = left.episodes.iter().enumerate();
    all.filter(|(n, _)| !chooses || n % 2 == 1)
        .filter_map(|(n, (track, score))| Some(score - counterpart(n, *track)?.1))
        .collect()
}

/// The best of the candidates by the first, third, ... episodes; of equals, the first.
fn best<'c>(candidates: &[&'c Cell], chooses: bool) -> &'c Cell {
    let value = |cell: &Cell| {
        let means = cell.trainings.iter().filter_map(|training| {
            let scores = training.episodes.iter().step_by(2).map(|episode| episode.1);
            inference::mean(&scores.collect::<Vec<_>>())
        });
        inference::mean(&means.collect::<Vec<_>>()).unwrap_or(f64::NEG_INFINITY)
    };
    let mut best = candidates[0];
    if chooses {
        for candidate in &candidates[1..] {
            if value(candidate) > value(best) {
                best = candidate;
            }
        }
    }
    best
}

impl Differences {
    /// True where there are enough values for an interval and a test.
    pub(crate) fn is_enough(&self) -> bool {
        self.values.len() >= if self.over == Over::Trainings { FEWEST_TRAININGS } else { FEWEST_EPISODES }
    }

    pub(crate) fn mean(&self) -> Option<f64> {
        inference::mean(&self.values)
    }

    /// Half the width of the 95 % interval, where there are enough values.
    pub(crate) fn half_width(&self) -> Option<f64> {
        if self.is_enough() { inference::half_width(&self.values) } else { None }
    }

    /// The p values of what would make a claim hold, and of what would contradict it.
    pub(crate) fn p(&self, relation: Relation, margin: f64) -> Option<(f64, f64)> {
        if !self.is_enough() {
            return None;
        }
        let above = |limit: f64| inference::p_above(&self.values, limit);
        // Both directions are looked at, so each one-sided value counts twice; an equivalence needs both of its own.
        let twice = |p: f64| (2.0 * p).min(1.0);
        Some(match relation {
            Relation::Greater => (twice(above(margin)?), twice(1.0 - above(margin)?)),
            Relation::NotGreater => (twice(1.0 - above(margin)?), twice(above(margin)?)),
            Relation::Equal => {
                let (low, high) = (above(-margin)?, above(margin)?);
                (low.max(1.0 - high), twice(high.min(1.0 - low)))
            }
        })
    }
}

/// The verdicts of claims that are tested together, with the p value of each after Holm's correction; `None` where there
/// are too few values.
pub(crate) fn verdicts(claims: &[Claim], measured: &[Measured]) -> Vec<(Verdict, Option<f64>)> {
    let each: Vec<Option<(f64, f64)>> =
        claims.iter().zip(measured).map(|(claim, measured)| measured.all.p(claim.is, claim.margin)).collect();
    // Claims that cannot be tested still count towards the family, so that the others gain nothing from them.
    let smaller: Vec<f64> =
        each.iter().map(|p| p.map_or(1.0, |(holds, against)| holds.min(against))).collect();
    let adjusted = inference::holm(&smaller);
    let verdict = |(p, adjusted): (&Option<(f64, f64)>, f64)| match p {
        None => (Verdict::Undecided, None),
        Some(_) if adjusted > 0.05 => (Verdict::Undecided, Some(adjusted)),
        Some((holds, against)) if holds <= against => (Verdict::Holds, Some(adjusted)),
        Some(_) => (Verdict::Contradicted, Some(adjusted)),
    };
    each.iter().zip(adjusted).map(verdict).collect()
}
