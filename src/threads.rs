//! Work side by side on the threads of the pool where the caller runs, results in the order of the work; without a pool, one thread.

use rayon::prelude::*;
use std::sync::{Mutex, PoisonError, TryLockError};

/// Pieces for each thread into which work is divided at least: a thread that comes to the end waits for no more than one.
const PIECES: usize = 64;

/// Whether the caller runs in a pool of more than one thread.
pub(crate) fn several() -> bool {
    rayon::current_thread_index().is_some() && rayon::current_num_threads() > 1
}

/// Pieces of work that know nothing of each other.
pub(crate) fn side_by_side<T: Sync, R: Send>(of: &[T], work: impl Fn(&T) -> R + Sync + Send) -> Vec<R> {
    gathered(true, of, work)
}

/// The same into a list, or into the first `None` or error of one; on threads where they are `worth` waking.
pub(crate) fn gathered<T: Sync, R: Send, C: FromParallelIterator<R> + FromIterator<R>>(
    worth: bool,
    of: &[T],
    work: impl Fn(&T) -> R + Sync + Send,
) -> C {
    if worth && several() {
        let most = (of.len() / (PIECES * rayon::current_num_threads())).max(1);
        of.par_iter().with_max_len(most).map(work).collect()
    } else {
        of.iter().map(work).collect()
    }
}

/// Work on each of a list where it lies.
pub(crate) fn each<T: Send>(of: &mut [T], work: impl Fn(&mut T) + Sync + Send) {
    if several() { of.par_iter_mut().for_each(work) } else { of.iter_mut().for_each(work) }
}

/// Two pieces of work that know nothing of each other.
pub(crate) fn both<A: Send, B: Send>(a: impl FnOnce() -> A + Send, b: impl FnOnce() -> B + Send) -> (A, B) {
    if several() { rayon::join(a, b) } else { (a(), b()) }
}

/// Work on what is still being found: handed over to the threads of the pool so many pieces at a time, results in the order of finding.
pub(crate) fn while_found<T: Send, R: Send>(
    at_once: usize,
    find: impl FnOnce(&mut dyn FnMut(T)) + Send,
    work: impl Fn(&T) -> R + Sync,
) -> Vec<R> {
    let done = Mutex::new(Vec::new());
    rayon::scope(|scope| {
        let (mut some, mut number) = (Vec::new(), 0);
        let mut hand_over = |some: Vec<T>| {
            let (done, work, own) = (&done, &work, number);
            number += 1;
            scope.spawn(move |_| {
                let results: Vec<R> = some.iter().map(work).collect();
                done.lock().unwrap_or_else(PoisonError::into_inner).push((own, results));
            });
        };
        find(&mut |piece| {
            some.push(piece);
            if some.len() >= at_once {
                hand_over(std::mem::take(&mut some));
            }
        });
        hand_over(some);
    });
    let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    done.sort_unstable_by_key(|x| x.0);
    done.into_iter().flat_map(|x| x.1).collect()
}

/// Memory that work uses again, one for each thread of the pool where it was made that does some of the work. (Made anew wherever rayon divides
/// the work, it costs more than the second thread saves: the allocator's locks.)
pub(crate) struct OwnMemory<S>(Vec<Mutex<Option<Box<S>>>>);

impl<S: Default> OwnMemory<S> {
    pub(crate) fn new() -> Self {
        let threads = if several() { rayon::current_num_threads() } else { 1 };
        Self((0..threads).map(|_| Mutex::new(None)).collect())
    }

    /// Does a piece of work with the memory of this thread; with new memory where a piece waits for another on the same thread.
    pub(crate) fn with<R>(&self, work: impl FnOnce(&mut S) -> R) -> R {
        let own = &self.0[rayon::current_thread_index().unwrap_or(0) % self.0.len()];
        match own.try_lock() {
            Ok(mut memory) => work(memory.get_or_insert_default()),
            Err(TryLockError::Poisoned(broken)) => work(broken.into_inner().get_or_insert_default()),
            Err(TryLockError::WouldBlock) => work(&mut S::default()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::ThreadPoolBuilder;

    /// Of lists that pieces divide and that they do not.
    #[test]
    fn all_of_a_list_is_worked_on() {
        for (threads, count) in [(1, 100), (2, 0), (2, 1), (2, 127), (2, 1000), (3, 1001)] {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut numbers: Vec<usize> = (0..count).collect();
                let doubled = side_by_side(&numbers, |n| 2 * n);
                each(&mut numbers, |n| *n *= 2);
                assert_eq!(numbers, doubled);
                assert!(numbers.iter().enumerate().all(|(k, n)| *n == 2 * k));
            });
        }
    }

    /// Results in order, and no more memories than threads.
    #[test]
    fn each_thread_uses_one_memory_again() {
        for threads in [1, 3] {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let (own, numbers) = (OwnMemory::<Vec<usize>>::new(), (0..1000).collect::<Vec<usize>>());
                let out = side_by_side(&numbers, |n| {
                    own.with(|seen| {
                        seen.push(*n);
                        2 * n
                    })
                });
                assert_eq!(out, (0..1000).map(|n| 2 * n).collect::<Vec<_>>());
                assert_eq!(own.0.len(), threads);
                let mut all: Vec<usize> =
                    own.0.into_iter().filter_map(|m| m.into_inner().unwrap()).flat_map(|seen| *seen).collect();
                all.sort_unstable();
                assert_eq!(all, numbers);
            });
        }
    }

    #[test]
    fn results_come_in_the_order_of_finding() {
        for (threads, count) in [(1, 100), (3, 0), (3, 1), (3, 997)] {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let out = pool.install(|| while_found(16, |found| (0..count).for_each(found), |n: &usize| 2 * n));
            assert_eq!(out, (0..count).map(|n| 2 * n).collect::<Vec<_>>());
        }
    }

    /// Work inside work, and after work that failed.
    #[test]
    fn memory_in_use_is_never_waited_for() {
        let own = OwnMemory::<usize>::new();
        let inner = own.with(|outer| {
            *outer = 1;
            own.with(|inner| *inner)
        });
        assert_eq!(inner, 0, "memory of its own");
        let broken = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| own.with(|_| panic!("broken"))));
        assert!(broken.is_err());
        assert_eq!(own.with(|memory| *memory), 1);
    }
}
