//! The address of a host that is given by its name. A look-up may take seconds, so that none is made in the loop: each has a thread.

use anyhow::{Context as _, Result};
use std::net::{SocketAddr, ToSocketAddrs as _};
use std::sync::mpsc::{self, Receiver, TryRecvError};
use std::thread;

/// The address, after as long as it takes.
pub fn resolve(remote: &str) -> Result<SocketAddr> {
    let found = remote.to_socket_addrs().with_context(|| format!("there is no host for {remote}"))?;
    let all: Vec<SocketAddr> = found.collect();
    // Ground stations listen on IPv4.
    all.iter()
        .find(|address| address.is_ipv4())
        .or(all.first())
        .copied()
        .with_context(|| format!("no address for {remote}"))
}

/// A look-up that is under way.
pub struct LookUp(Receiver<Result<SocketAddr>>);

impl LookUp {
    pub fn begin(remote: String) -> LookUp {
        let (sender, receiver) = mpsc::channel();
        // The caller may have dropped its end.
        thread::spawn(move || drop(sender.send(resolve(&remote))));
        LookUp(receiver)
    }

    /// The address, once it is known.
    pub fn result(&self) -> Option<Result<SocketAddr>> {
        match self.0.try_recv() {
            Ok(result) => Some(result),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => Some(Err(anyhow::anyhow!("the look-up has ended"))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::{Duration, Instant};

    #[test]
    fn a_look_up_has_no_result_at_first_and_one_later() {
        let look_up = LookUp::begin(String::from("127.0.0.1:14550"));
        let start = Instant::now();
        let result = loop {
            if let Some(result) = look_up.result() {
                break result;
            }
            assert!(start.elapsed() < Duration::from_secs(10));
            thread::yield_now();
        };
        assert_eq!(result.unwrap(), "127.0.0.1:14550".parse().unwrap());
    }
}
