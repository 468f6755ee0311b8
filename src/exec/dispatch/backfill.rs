//! EASY backfilling (D. Lifka, "The ANL/IBM SP scheduling system", 1995): while the first stage of the queue waits for more
//! threads than are free, shorter stages may start that will probably end before it could start anyway. So no thread idles
//! while a two-thread stage waits for a long one, and small stages do not delay it forever. Costs are estimates, so there is a
//! bound that does not need them: once the first stage waits only for stages that were started this way, no more are.

use std::time::Instant;

use super::Dispatcher;
use crate::resolve::StageIndex;

/// Stages of the queue that are considered.
const DEPTH: usize = 64;

/// Running stages, and the speed of this run.
#[derive(Debug, Default)]
pub(super) struct Pace {
    running: Vec<Running>,
    /// The stage that waits for threads, and those that were started before it.
    waits: Option<StageIndex>,
    backfilled: Vec<StageIndex>,
    /// Of ended stages: total cost, and total seconds.
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

    /// True where `first` waits for stages other than the backfilled ones: without these, it still could not start.
    fn waits_for_others(&mut self, first: StageIndex, free: usize, wanted: usize) -> bool {
        if self.waits != Some(first) {
            self.waits = Some(first);
            self.backfilled.clear();
        }
        let backfilled = self.running.iter().filter(|running| self.backfilled.contains(&running.stage));
        free + backfilled.map(|running| running.threads).sum::<usize>() < wanted
    }

    /// Seconds per unit of cost so far. Kinds estimate seconds, so it is 1 at first.
    fn rate(&self) -> f64 {
        let (cost, seconds) = self.done;
        if cost > 0.0 && seconds > 0.0 { seconds / cost } else { 1.0 }
    }

    /// Seconds until `wanted` threads are free.
    fn until_free(&self, free: usize, wanted: usize) -> f64 {
        let mut left: Vec<(f64, usize)> = self
            .running
            .iter()
            .map(|running| {
                let took = running.began.elapsed().as_secs_f64();
                let left = running.cost * self.rate() - took;
                // A stage that is overdue is expected to take as long again.
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
    /// Takes the first stage of the queue that fits and will end before `first` could start.
    pub(super) fn backfill(&mut self, first: StageIndex, free: usize) -> Option<StageIndex> {
        if free == 0 {
            return None;
        }
        let wanted = self.threads(first).min(self.budget());
        if !self.pace.waits_for_others(first, free, wanted) {
            return None;
        }
        let until = self.pace.until_free(free, wanted);
        let rate = self.pace.rate();
        let (context, pool) = (self.context, &self.pool);
        let fits = |stage: StageIndex| {
            let node = &context.graph.stages[stage];
            node.needs.threads.max(1) <= free
                && pool.has(&node.resources)
                && context.order.own_cost(context.graph, stage) * rate <= until
        };
        let found = self.ready.take_first(DEPTH, fits);
        self.pace.backfilled.extend(found);
        found
    }

    /// Takes a stage of the queue that can start while `first` waits for a resource. It must not use that resource itself, so
    /// that `first` is not delayed.
    pub(super) fn pass_by(&mut self, first: StageIndex, free: usize) -> Option<StageIndex> {
        let graph = self.context.graph;
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
        self.context.order.own_cost(self.context.graph, stage)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_waits_for_the_threads_that_are_free_first() {
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
    fn a_stage_that_waits_only_for_backfilled_ones_is_not_delayed_by_more() {
        let (long, wide, small, other) =
            (StageIndex::new(0), StageIndex::new(1), StageIndex::new(2), StageIndex::new(3));
        let mut pace = Pace::default();
        pace.began(long, 1, 100.0);
        assert!(pace.waits_for_others(wide, 1, 2));
        pace.backfilled.push(small);
        pace.began(small, 1, 1.0);
        // First the long stage occupies what the wide one needs; then only the small one does.
        assert!(pace.waits_for_others(wide, 0, 2));
        pace.ended(long);
        assert!(!pace.waits_for_others(wide, 1, 2));
        // For another stage, everything that runs was there before.
        assert!(pace.waits_for_others(other, 1, 2));
    }

    #[test]
    fn an_overdue_stage_is_expected_to_take_as_long_again() {
        let mut pace = Pace::default();
        pace.began(StageIndex::new(0), 1, 0.0);
        std::thread::sleep(std::time::Duration::from_millis(5));
        assert!(pace.until_free(0, 1) >= 0.005);
    }
}
