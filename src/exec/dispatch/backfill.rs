//! What may start before the first of the queue, when that one wants more threads than are free: stages that will
//! probably be done before it could start anyway. So a stage of two threads neither leaves a thread idle while it waits
//! for a long one, nor is it kept waiting by ever more small ones (EASY backfilling; D. Lifka, "The ANL/IBM SP
//! scheduling system", 1995). Costs are guesses, so there is a bound that needs none: once the first waits for nothing but
//! what slipped in before it, nothing more slips in.

use std::time::Instant;

use super::Dispatcher;
use crate::resolve::StageIndex;

/// So many stages of the queue are looked at.
const DEPTH: usize = 64;

/// Running stages, and how fast work is done in this run.
#[derive(Debug, Default)]
pub(super) struct Pace {
    running: Vec<Running>,
    /// The stage that waits for room, and those that slipped in before it.
    waits: Option<StageIndex>,
    slipped: Vec<StageIndex>,
    /// Of stages that ended: their cost, and the seconds they took.
    done: (f64, f64),
}

#[derive(Debug)]
struct Running {
    stage: StageIndex,
    threads: usize,
    cost: f64,
    began: Instant,
}

impl Pace {
    pub fn began(&mut self, stage: StageIndex, threads: usize, cost: f64) {
        self.running.push(Running { stage, threads, cost, began: Instant::now() });
    }

    pub fn ended(&mut self, stage: StageIndex) {
        if let Some(at) = self.running.iter().position(|running| running.stage == stage) {
            let running = self.running.swap_remove(at);
            self.done.0 += running.cost;
            self.done.1 += running.began.elapsed().as_secs_f64();
        }
    }

    /// True where `first` waits for others than those that slipped in before it: with these over it still had no room.
    fn waits_for_others(&mut self, first: StageIndex, free: usize, wanted: usize) -> bool {
        if self.waits != Some(first) {
            self.waits = Some(first);
            self.slipped.clear();
        }
        let slipped = self.running.iter().filter(|running| self.slipped.contains(&running.stage));
        free + slipped.map(|running| running.threads).sum::<usize>() < wanted
    }

    /// Seconds for a unit of cost, by what is done; kinds mean seconds unless they are wrong.
    fn rate(&self) -> f64 {
        let (cost, seconds) = self.done;
        if cost > 0.0 && seconds > 0.0 { seconds / cost } else { 1.0 }
    }

    /// Seconds until so many threads are free.
    fn until_free(&self, free: usize, wanted: usize) -> f64 {
        let mut left: Vec<(f64, usize)> = self
            .running
            .iter()
            .map(|running| {
                let took = running.began.elapsed().as_secs_f64();
                let left = running.cost * self.rate() - took;
                // One that takes longer than it should will, by all that is known, take as long again.
                (if left > 0.0 { left } else { took }, running.threads)
            })
            .collect();
        left.sort_by(|one, other| one.0.total_cmp(&other.0));
        let mut free = free;
        for (seconds, threads) in left {
            free += threads;
            if free >= wanted {
                return seconds;
            }
        }
        f64::INFINITY
    }
}

impl Dispatcher<'_, '_> {
    /// Takes the first stage of the queue that has room and will be done before `first` could start.
    pub(super) fn slip_in(&mut self, first: StageIndex, free: usize) -> Option<StageIndex> {
        if free == 0 {
            return None;
        }
        let wanted = self.threads(first).min(self.budget());
        if !self.pace.waits_for_others(first, free, wanted) {
            return None;
        }
        let until = self.pace.until_free(free, wanted);
        let rate = self.pace.rate();
        let (shape, graph) = (self.shape, self.shape.graph);
        let pool = &self.pool;
        let fits = |stage: StageIndex| {
            let node = &graph.stages[stage];
            node.needs.threads.max(1) <= free
                && pool.has(&node.resources)
                && shape.order.own_cost(shape.graph, stage) * rate <= until
        };
        let found = self.ready.take_first(DEPTH, fits);
        self.pace.slipped.extend(found);
        found
    }

    /// Takes a stage of the queue that can start while `first` waits for a resource: one that asks for nothing of what the
    /// first waits for, so that it is not kept waiting.
    pub(super) fn pass_by(&mut self, first: StageIndex, free: usize) -> Option<StageIndex> {
        let graph = self.shape.graph;
        let (waits_for, pool) = (&graph.stages[first].resources, &self.pool);
        let idle = self.running == 0;
        self.ready.take_first(DEPTH, |stage| {
            let node = &graph.stages[stage];
            (idle || node.needs.threads.max(1) <= free)
                && pool.has(&node.resources)
                && !node.resources.keys().any(|name| waits_for.contains_key(name))
        })
    }

    pub(super) fn own_cost(&self, stage: StageIndex) -> f64 {
        self.shape.order.own_cost(self.shape.graph, stage)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_waits_for_the_threads_that_come_free_first() {
        let mut pace = Pace::default();
        for (stage, threads, cost) in [(0, 1, 100.0), (1, 1, 10.0), (2, 2, 1000.0)] {
            pace.began(StageIndex::new(stage), threads, cost);
        }
        let near = |seconds: f64, expected: f64| (seconds - expected).abs() < 1.0;
        assert!(near(pace.until_free(0, 1), 10.0) && near(pace.until_free(1, 2), 10.0));
        assert!(near(pace.until_free(0, 2), 100.0) && near(pace.until_free(0, 4), 1000.0));
        assert_eq!(pace.until_free(0, 5), f64::INFINITY);
        pace.ended(StageIndex::new(1));
        assert!(pace.done.0 > 0.0 && pace.running.len() == 2);
    }

    #[test]
    fn a_stage_that_waits_only_for_those_that_slipped_in_is_not_kept_waiting_by_more() {
        let (long, wide, small, other) =
            (StageIndex::new(0), StageIndex::new(1), StageIndex::new(2), StageIndex::new(3));
        let mut pace = Pace::default();
        pace.began(long, 1, 100.0);
        assert!(pace.waits_for_others(wide, 1, 2));
        pace.slipped.push(small);
        pace.began(small, 1, 1.0);
        // The long one still holds what the wide one wants; then only the small one does, however long it takes.
        assert!(pace.waits_for_others(wide, 0, 2));
        pace.ended(long);
        assert!(!pace.waits_for_others(wide, 1, 2));
        // For another stage everything that runs was there before.
        assert!(pace.waits_for_others(other, 1, 2));
    }

    #[test]
    fn one_that_takes_longer_than_it_should_is_expected_to_take_as_long_again() {
        let mut pace = Pace::default();
        pace.began(StageIndex::new(0), 1, 0.0);
        std::thread::sleep(std::time::Duration::from_millis(5));
        assert!(pace.until_free(0, 1) >= 0.005);
    }
}
