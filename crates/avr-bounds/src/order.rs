//! The order in which the instructions of a function are followed: loops within loops.
//!
//! Every path that comes back to an instruction passes the head of a loop, also in a loop that can
//! be entered at several places. So an order of the parts is a topological order of the function
//! without the jumps to heads.

use std::collections::{BTreeMap, BTreeSet};

/// A part of a function, after those that lead to it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Part {
    /// An instruction.
    Instruction(u32),
    /// A loop.
    Loop(Loop),
}

/// Instructions that can be reached from each other.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Loop {
    /// The instruction that all rounds begin with.
    pub head: u32,
    /// The other instructions.
    pub body: Vec<Part>,
    /// All instructions with the head.
    pub nodes: BTreeSet<u32>,
}

type Edges = BTreeMap<u32, Vec<u32>>;

/// The parts of a function.
pub fn parts(edges: &BTreeSet<(u32, u32)>, entry: u32) -> Vec<Part> {
    let mut nodes: BTreeSet<u32> = edges.iter().flat_map(|(from, to)| [*from, *to]).collect();
    nodes.insert(entry);
    let mut after: Edges = BTreeMap::new();
    for (from, to) in edges {
        after.entry(*from).or_default().push(*to);
    }
    order(&after, &nodes, entry)
}

/// The loops in an order, with the inner ones, sorted by the address of the head.
pub fn heads(parts: &[Part]) -> Vec<u32> {
    let mut heads = Vec::new();
    for part in parts {
        if let Part::Loop(inner) = part {
            heads.push(inner.head);
            heads.extend(self::heads(&inner.body));
        }
    }
    heads.sort_unstable();
    heads
}

fn order(after: &Edges, nodes: &BTreeSet<u32>, entry: u32) -> Vec<Part> {
    let mut parts = Vec::new();
    for component in components(after, nodes, entry) {
        let first = *component.first().unwrap_or(&entry);
        let goes_to = |node: &u32, to: u32| after.get(node).is_some_and(|next| next.contains(&to));
        if component.len() == 1 && !goes_to(&first, first) {
            parts.push(Part::Instruction(first));
            continue;
        }
        let is_entered = |node: u32| {
            node == entry
                || nodes.iter().any(|from| !component.contains(from) && goes_to(from, node))
        };
        let head = component.iter().copied().find(|node| is_entered(*node)).unwrap_or(first);
        let mut rest = component.clone();
        rest.remove(&head);
        // Without the head the rest is reached from all that the head, or the outside, leads to.
        let body = order(after, &rest, head);
        parts.push(Part::Loop(Loop { head, body, nodes: component }));
    }
    parts
}

/// The sets of instructions that reach each other, in topological order (Kosaraju's algorithm).
fn components(after: &Edges, nodes: &BTreeSet<u32>, entry: u32) -> Vec<BTreeSet<u32>> {
    let mut before: Edges = BTreeMap::new();
    for (from, targets) in after.iter().filter(|(from, _)| nodes.contains(from)) {
        for to in targets.iter().filter(|to| nodes.contains(to)) {
            before.entry(*to).or_default().push(*from);
        }
    }
    let mut seen = BTreeSet::new();
    let mut finished = Vec::new();
    for start in std::iter::once(entry).chain(nodes.iter().copied()) {
        if nodes.contains(&start) {
            search(after, nodes, start, &mut seen, &mut finished);
        }
    }
    let mut seen = BTreeSet::new();
    let mut components = Vec::new();
    for start in finished.into_iter().rev() {
        let mut component = Vec::new();
        search(&before, nodes, start, &mut seen, &mut component);
        if !component.is_empty() {
            components.push(component.into_iter().collect());
        }
    }
    components
}

/// A depth-first search that adds each new node when all behind it are done.
fn search(
    after: &Edges,
    nodes: &BTreeSet<u32>,
    start: u32,
    seen: &mut BTreeSet<u32>,
    finished: &mut Vec<u32>,
) {
    if !seen.insert(start) {
        return;
    }
    let mut path = vec![(start, 0)];
    while let Some((node, next)) = path.last_mut() {
        let target = after.get(node).and_then(|targets| targets.get(*next)).copied();
        *next += 1;
        match target {
            Some(to) => {
                if nodes.contains(&to) && seen.insert(to) {
                    path.push((to, 0));
                }
            }
            None => {
                finished.push(*node);
                path.pop();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn edges(list: &[(u32, u32)]) -> BTreeSet<(u32, u32)> {
        list.iter().copied().collect()
    }

    #[test]
    fn a_loop_within_a_loop_is_a_part_of_its_body() {
        let parts = parts(&edges(&[(0, 2), (2, 4), (4, 6), (6, 4), (6, 8), (8, 2), (8, 10)]), 0);
        assert_eq!(heads(&parts), [2, 4]);
        let [Part::Instruction(0), Part::Loop(outer), Part::Instruction(10)] = &parts[..] else {
            panic!("{parts:?}")
        };
        let [Part::Loop(inner), Part::Instruction(8)] = &outer.body[..] else {
            panic!("{outer:?}")
        };
        assert_eq!((inner.head, inner.nodes.len()), (4, 2));
    }

    #[test]
    fn a_loop_with_two_entries_has_one_head() {
        let parts = parts(&edges(&[(0, 2), (0, 4), (2, 4), (4, 2), (4, 6)]), 0);
        assert_eq!(heads(&parts).len(), 1);
    }
}
