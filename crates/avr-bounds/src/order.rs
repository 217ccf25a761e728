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
    /// The instructions from where the loop is entered to the head. They are in the body, too.
    pub lead: Vec<u32>,
    /// All instructions with the head.
    pub nodes: BTreeSet<u32>,
}

type Edges = BTreeMap<u32, Vec<u32>>;

/// The parts of a function. If it `never_returns`, its largest loop is the main loop: the
/// instructions before the place to which most rounds come back belong to the rounds that pass them
/// (the compiler may set a register again that only some rounds change).
pub fn parts(edges: &BTreeSet<(u32, u32)>, entry: u32, never_returns: bool) -> Vec<Part> {
    let mut nodes: BTreeSet<u32> = edges.iter().flat_map(|(from, to)| [*from, *to]).collect();
    nodes.insert(entry);
    let mut after: Edges = BTreeMap::new();
    for (from, to) in edges {
        after.entry(*from).or_default().push(*to);
    }
    let main_loop = never_returns
        .then(|| components(&after, &nodes, entry).into_iter().max_by_key(BTreeSet::len))
        .flatten();
    order(&after, &nodes, entry, main_loop.as_ref())
}

/// The straight line from the entry of a loop to the instruction to which most rounds come back,
/// and that instruction.
fn most_common(after: &Edges, component: &BTreeSet<u32>, mut head: u32) -> (Vec<u32>, u32) {
    let mut lead = Vec::new();
    let leading_to = |to: u32| {
        let leads = |from: &&u32| after.get(*from).is_some_and(|next| next.contains(&to));
        component.iter().filter(leads).count()
    };
    while let Some([next]) = after.get(&head).map(Vec::as_slice)
        && component.contains(next)
        && leading_to(*next) > leading_to(head) + 1
    {
        lead.push(head);
        head = *next;
    }
    (lead, head)
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

fn order(
    after: &Edges,
    nodes: &BTreeSet<u32>,
    entry: u32,
    main_loop: Option<&BTreeSet<u32>>,
) -> Vec<Part> {
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
        let mut head = component.iter().copied().find(|node| is_entered(*node)).unwrap_or(first);
        let mut lead = Vec::new();
        if main_loop == Some(&component) {
            (lead, head) = most_common(after, &component, head);
        }
        let mut rest = component.clone();
        rest.remove(&head);
        // Without the head the rest is reached from all that the head, or the outside, leads to.
        let body = order(after, &rest, head, None);
        parts.push(Part::Loop(Loop { head, body, lead, nodes: component }));
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
        let parts =
            parts(&edges(&[(0, 2), (2, 4), (4, 6), (6, 4), (6, 8), (8, 2), (8, 10)]), 0, false);
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
        let parts = parts(&edges(&[(0, 2), (0, 4), (2, 4), (4, 2), (4, 6)]), 0, false);
        assert_eq!(heads(&parts).len(), 1);
    }

    /// One round in four sets a register at 2, and the others come back to 4.
    #[test]
    fn a_main_loop_begins_where_most_rounds_come_back() {
        let edges =
            edges(&[(0, 2), (2, 4), (4, 6), (4, 8), (6, 2), (6, 4), (8, 4), (8, 10), (10, 4)]);
        let loops = |never_returns| heads(&parts(&edges, 0, never_returns));
        assert_eq!(loops(false), [2, 4]);
        assert_eq!(loops(true), [4]);
    }
}
