//! Threads of one piece of work: started for it, ended before it returns.

use crate::error::{Invalid, Result};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

/// More threads than any machine has come from a mistaken argument.
pub const MOST_THREADS: usize = 1024;

/// Stack of a thread that the library starts.
pub const STACK_BYTES: usize = 2 << 20;

/// A thread pool of its own whose threads have ended when it is dropped.
///
/// A pool of rayon tells its threads to end but does not wait for them; in a host that unloads the library they would
/// go on in code that is no longer there.
pub struct Workers {
    pool: Option<rayon::ThreadPool>,
    threads: Arc<Mutex<Vec<JoinHandle<()>>>>,
}

impl Workers {
    /// `threads` threads; 0 takes as many as the machine has, whatever variables of the environment say: they are the host's.
    ///
    /// # Errors
    /// [`Invalid::Value`] beyond [`MOST_THREADS`], [`Invalid::Threads`] where the system gives no threads.
    pub fn new(threads: usize) -> Result<Self> {
        if threads > MOST_THREADS {
            let expected = format!("at most {MOST_THREADS}; without it all processors are used");
            return Err(Invalid::value("threads", threads as f64, expected).into());
        }
        let all = || std::thread::available_parallelism().map_or(1, usize::from).min(MOST_THREADS);
        let threads = if threads == 0 { all() } else { threads };
        Self::started(threads, |worker| {
            // Said here, or a variable of the host's environment decides.
            std::thread::Builder::new().name("spivcal".into()).stack_size(STACK_BYTES).spawn(|| worker.run())
        })
    }

    fn started(
        threads: usize,
        mut start: impl FnMut(rayon::ThreadBuilder) -> std::io::Result<JoinHandle<()>>,
    ) -> Result<Self> {
        let handles = Arc::new(Mutex::new(Vec::new()));
        let kept = Arc::clone(&handles);
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .spawn_handler(move |worker| {
                let handle = start(worker)?;
                kept.lock().unwrap_or_else(PoisonError::into_inner).push(handle);
                Ok(())
            })
            .build();
        let workers = |pool| Self { pool, threads: handles };
        match pool {
            Ok(pool) => Ok(workers(Some(pool))),
            Err(e) => {
                // Those that were started before the system refused end here.
                drop(workers(None));
                Err(Invalid::Threads { threads, message: e.to_string() }.into())
            }
        }
    }

    /// Runs `work` with parallel iterators on these threads.
    pub fn install<R: Send>(&self, work: impl FnOnce() -> R + Send) -> R {
        match &self.pool {
            Some(pool) => pool.install(work),
            None => work(),
        }
    }
}

impl Drop for Workers {
    fn drop(&mut self) {
        drop(self.pool.take());
        let threads = std::mem::take(&mut *self.threads.lock().unwrap_or_else(PoisonError::into_inner));
        for thread in threads {
            // A panic of the work has been handed to whoever installed it.
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;
    use std::sync::Weak;

    #[test]
    fn no_thread_outlives_the_pool() {
        for count in [1, 3] {
            let workers = Workers::new(count).unwrap();
            let sum: u64 = workers.install(|| {
                assert_eq!(rayon::current_num_threads(), count);
                (0..1000u64).into_par_iter().sum()
            });
            assert_eq!(sum, 499_500);
            let threads: Weak<_> = Arc::downgrade(&workers.threads);
            assert_eq!(workers.threads.lock().unwrap().len(), count);
            drop(workers);
            assert!(threads.upgrade().is_none(), "the pool's own closure still lives");
        }
    }

    #[test]
    fn threads_that_the_system_refuses_are_no_defect() {
        let mut left = 1;
        let workers = Workers::started(3, |worker| {
            if left == 0 {
                return Err(std::io::Error::other("no more"));
            }
            left -= 1;
            std::thread::Builder::new().spawn(|| worker.run())
        });
        let Err(error) = workers else { panic!("there is one thread of three") };
        assert_eq!(error.exit_code(), 2);
        let told = error.to_string();
        assert!(told.contains("3 threads") && told.contains("no more") && told.contains("ask for fewer"), "{told}");
    }

    #[test]
    fn no_number_is_that_of_the_processors() {
        let all = std::thread::available_parallelism().map_or(1, usize::from);
        let workers = Workers::new(0).unwrap();
        assert_eq!(workers.threads.lock().unwrap().len(), all);
    }

    #[test]
    fn a_mistaken_number_of_threads_is_refused() {
        let refused = Workers::new(100_000).err().unwrap().to_string();
        assert!(refused.contains("threads = 100000 is not allowed: expected at most 1024"), "{refused}");
    }

    #[test]
    fn a_panic_reaches_the_caller_and_the_threads_still_end() {
        let workers = Workers::new(2).unwrap();
        let caught = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            workers.install(|| (0..10).into_par_iter().for_each(|i| assert!(i != 7, "seven")));
        }));
        assert!(caught.is_err());
    }
}
