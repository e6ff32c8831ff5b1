% The eight operations of the thesis's benchmark (section 5.2), each timed once, and each answer examined.
% octave-cli --norc octave.m N: a line of JSON for each operation.
1;

function tell (name, seconds, error_norm)
  if (! (error_norm < 1e-6))
    fprintf (stderr, "%s: the answer is wrong: its error is %g\n", name, error_norm);
    exit (1);
  endif
  printf ("{\"operation\": \"%s\", \"seconds\": %.6f}\n", name, seconds);
  fflush (stdout);
endfunction

n = str2double (argv (){end});
printf ("{\"engine\": \"Octave %s\"}\n", version ());
rand ("twister", 1);
tic; a = rand (n); t = toc;
tell ("create", t, ! (abs (mean (a(:)) - 0.5) < 3 / n));
tic; b = a * a; t = toc;
x = rand (n, 1);
tell ("multiply", t, norm (b * x - a * (a * x)) / norm (b * x));
clear b
tic; [l, u, p] = lu (a); t = toc;
tell ("lu", t, norm (l * (u * x) - p * (a * x)) / norm (a * x));
clear l u p
tic; b = inv (a); t = toc;
tell ("inverse", t, norm (a * (b * x) - x) / norm (x));
clear b
tic; [u, s, v] = svd (a); t = toc;
tell ("svd", t, norm (u * (s * (v' * x)) - a * x) / norm (a * x));
clear u s v
tic; [q, r] = qr (a); t = toc;
tell ("qr", t, norm (q * (r * x) - a * x) / norm (a * x));
clear q r
tic; [v, d] = eig (a); t = toc;
tell ("eigen", t, norm (a * v(:, 1) - d(1, 1) * v(:, 1)) / abs (d(1, 1)));
clear v d
tic; r = rank (a); t = toc;
tell ("rank", t, abs (r - n));
