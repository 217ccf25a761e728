//! Runs simulations side by side.

use std::sync::Mutex;

/// Calls `run` for each item, with one thread per core, and returns the results in the order of the
/// items. The last items are started first, so the longest ones belong at the end.
pub fn each<T: Sync, R: Send>(items: &[T], run: impl Fn(&T) -> R + Sync) -> Vec<R> {
    let left = Mutex::new((0..items.len()).collect::<Vec<_>>());
    let results = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(1, usize::from) {
            scope.spawn(|| {
                while let Some(n) = { left.lock().unwrap().pop() } {
                    let result = run(&items[n]);
                    results.lock().unwrap().push((n, result));
                }
            });
        }
    });
    let mut results = results.into_inner().unwrap();
    results.sort_by_key(|(n, _)| *n);
    results.into_iter().map(|(_, result)| result).collect()
}
