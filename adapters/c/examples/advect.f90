! advect N STEPS [CONFIG]: a puff turns about the middle of a box and spreads, from Fortran. dc/dt = -u.grad(c) + D Laplacian(c),
! upwind, one layer of ghosts. Prints a checksum of the last step, which is the same with and without gloaming. Compiled
! so that the solver stops at its first NaN, overflow or division by zero, which gloaming's threads do not inherit.
!
!   gfortran -O2 -ffpe-trap=invalid,zero,overflow $(pkg-config --variable=fortran gloaming) advect.f90 \
!       $(pkg-config --libs gloaming) -o advect && ./advect 64 100 advect.toml
program advect
    use, intrinsic :: iso_c_binding
    use, intrinsic :: iso_fortran_env, only: error_unit
    use gloaming
    implicit none
    integer :: n, steps, step, count
    real(c_float), allocatable :: now(:, :, :), next(:, :, :), shown(:, :, :), kept(:, :, :)
    type(c_ptr) :: lit
    type(gloaming_error) :: error
    type(gloaming_stats) :: stats
    integer(c_int32_t) :: code
    real(c_double), allocatable :: held(:), plain(:)
    character(1000) :: config

    n = argument(1, 48)
    steps = argument(2, 48)
    lit = c_null_ptr
    if (command_argument_count() > 2) then
        call get_command_argument(3, config)
        lit = gloaming_open_file(trim(config), error)
        if (.not. c_associated(lit)) write (error_unit, *) "without pictures: ", gloaming_message(error)
    end if

    allocate (now(0:n + 1, 0:n + 1, 0:n + 1), next(0:n + 1, 0:n + 1, 0:n + 1), held(steps), plain(steps))
    allocate (shown(n, n, n), kept(n, n, n))
    kept = 0
    call begin()
    count = 0
    do step = 0, steps - 1
        call advance()
        if (.not. c_associated(lit)) cycle
        if (mod(step, 2) == 0) then
            ! A dense array, whose copy is what a push is held against…
            shown = now(1:n, 1:n, 1:n)
            count = count + 1
            plain(count) = seconds()
            kept = shown
            plain(count) = seconds() - plain(count)
            held(count) = seconds()
            code = gloaming_push(lit, step, 0.1d0*step, shown, error=error)
            held(count) = seconds() - held(count)
            ! A step that was dropped was not copied.
            if (code /= GLOAMING_OK) count = count - 1
        else
            ! … and the solver's own, with its ghosts.
            code = gloaming_push(lit, step, 0.1d0*step, now, ghosts=1, origin=[-1d0, -1d0, -1d0], error=error)
        end if
        if (code > 0) write (error_unit, *) "step ", step, ": ", gloaming_message(error)
    end do
    if (c_associated(lit)) then
        code = gloaming_close(lit, stats, error)
        if (code /= GLOAMING_OK) write (error_unit, *) gloaming_message(error)
        write (error_unit, '(i0, a, i0, a, f0.3)') stats%lit, " of ", stats%pushed, " steps lit; largest value ", maxval(kept)
        write (error_unit, '(3(a, f0.3))') "push of a dense array: held ", 1d3*median(held(:count)), &
            " ms a step, a plain copy ", 1d3*median(plain(:count)), " ms, ratio ", &
            median(held(:count))/max(median(plain(:count)), 1d-9)
    end if
    write (*, '(z8.8, z8.8)') sum_of_bits(), transfer(maxval(now), 0)

contains

    subroutine begin()
        integer :: i, j, k
        now = 0
        do k = 1, n
            do j = 1, n
                do i = 1, n
                    now(i, j, k) = exp(-60.0*((real(i)/n - 0.3)**2 + (real(j)/n - 0.5)**2 + (real(k)/n - 0.5)**2))
                end do
            end do
        end do
        next = now
    end subroutine

    subroutine advance()
        integer :: i, j, k
        real(c_float) :: u, v, flow
        real(c_float), parameter :: courant = 0.4, spread = 0.02
        do k = 1, n
            do j = 1, n
                v = 0.0
                do i = 1, n
                    u = -(real(j)/n - 0.5)*2*courant
                    v = (real(i)/n - 0.5)*2*courant
                    flow = max(u, 0.0)*(now(i, j, k) - now(i - 1, j, k)) + min(u, 0.0)*(now(i + 1, j, k) - now(i, j, k)) &
                           + max(v, 0.0)*(now(i, j, k) - now(i, j - 1, k)) + min(v, 0.0)*(now(i, j + 1, k) - now(i, j, k))
                    next(i, j, k) = now(i, j, k) - flow + spread*(now(i - 1, j, k) + now(i + 1, j, k) + now(i, j - 1, k) &
                                    + now(i, j + 1, k) + now(i, j, k - 1) + now(i, j, k + 1) - 6*now(i, j, k))
                end do
            end do
        end do
        now(1:n, 1:n, 1:n) = next(1:n, 1:n, 1:n)
    end subroutine

    function sum_of_bits() result(hash)
        integer(c_int32_t) :: hash
        integer :: i, j, k
        hash = 0
        do k = 1, n
            do j = 1, n
                do i = 1, n
                    hash = ieor(ishftc(hash, 5), transfer(now(i, j, k), hash))
                end do
            end do
        end do
    end function

    function argument(index, default) result(value)
        integer, intent(in) :: index, default
        integer :: value
        character(20) :: text
        value = default
        if (command_argument_count() >= index) then
            call get_command_argument(index, text)
            read (text, *) value
        end if
    end function

    function seconds() result(t)
        real(c_double) :: t
        integer(c_int64_t) :: ticks, rate
        call system_clock(ticks, rate)
        t = real(ticks, c_double)/real(rate, c_double)
    end function

    function median(values) result(m)
        real(c_double), intent(in) :: values(:)
        real(c_double) :: m, sorted(size(values)), v
        integer :: i, j
        sorted = values
        do i = 2, size(sorted)
            v = sorted(i)
            j = i - 1
            do while (j >= 1)
                if (sorted(j) <= v) exit
                sorted(j + 1) = sorted(j)
                j = j - 1
            end do
            sorted(j + 1) = v
        end do
        m = 0
        if (size(sorted) > 0) m = sorted(size(sorted)/2 + 1)
    end function
end program
