//! Topological order and cycles. Without recursion, because the depth comes from the user's file.

/// What [`order`] found.
pub(super) struct Order {
    /// Topological order of everything that does not depend on a cycle.
    pub sorted: Vec<usize>,
    /// Cycles, each as a path in which every element depends on the next and the last on the first.
    pub cycles: Vec<Vec<usize>>,
}

/// Sorts `0..dependencies.len()`; `dependencies[i]` lists what `i` depends on, and may repeat itself.
pub(super) fn order(dependencies: &[Vec<usize>]) -> Order {
    let mut dependants: Vec<Vec<usize>> = vec![Vec::new(); dependencies.len()];
    let mut open: Vec<usize> = vec![0; dependencies.len()];
    for (node, needs) in dependencies.iter().enumerate() {
        for &need in needs {
            dependants[need].push(node);
            open[node] += 1;
        }
    }
    let mut sorted: Vec<usize> = (0..dependencies.len()).filter(|node| open[*node] == 0).collect();
    let mut next = 0;
    while next < sorted.len() {
        for &dependant in &dependants[sorted[next]] {
            open[dependant] -= 1;
            if open[dependant] == 0 {
                sorted.push(dependant);
            }
        }
        next += 1;
    }
    let cycles = cycles(dependencies, &open);
    Order { sorted, cycles }
}

/// The cycles among the remaining nodes. Each of them depends on another remaining one, so following dependencies reaches a cycle.
fn cycles(dependencies: &[Vec<usize>], open: &[usize]) -> Vec<Vec<usize>> {
    let mut walked_from: Vec<Option<usize>> = vec![None; open.len()];
    let mut cycles = Vec::new();
    for start in (0..open.len()).filter(|node| open[*node] > 0) {
        let mut path = Vec::new();
        let mut node = start;
        while walked_from[node].is_none() {
            walked_from[node] = Some(start);
            path.push(node);
            let Some(next) = dependencies[node].iter().find(|need| open[**need] > 0) else { break };
            node = *next;
        }
        // Another start means that the cycle at the end of this path is known already.
        if walked_from[node] == Some(start)
            && let Some(begin) = path.iter().position(|at| *at == node)
        {
            cycles.push(path.split_off(begin));
        }
    }
    cycles
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_a_cycle_everything_comes_after_what_it_depends_on() {
        let found = order(&[vec![1, 2], vec![2, 2], vec![], vec![0]]);
        assert_eq!(found.sorted, [2, 1, 0, 3]);
        assert!(found.cycles.is_empty());
    }

    #[test]
    fn each_cycle_is_found_once_without_what_only_depends_on_it() {
        // 0 -> 1 -> 2 -> 1, 3 -> 3, 4 -> 3, 5 free.
        let found = order(&[vec![1], vec![2], vec![1], vec![3], vec![3], vec![]]);
        assert_eq!(found.cycles, [vec![1, 2], vec![3]]);
        assert_eq!(found.sorted, [5]);
    }

    #[test]
    fn a_chain_of_a_hundred_thousand_is_sorted() {
        let chain: Vec<Vec<usize>> =
            (0..100_000).map(|n| if n == 0 { vec![] } else { vec![n - 1] }).collect();
        assert_eq!(order(&chain).sorted.len(), 100_000);
    }
}
